"""Two arms of one file: identified one after the other, and exported into one file."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from exporters.c_arms import torque_of
from exporters.test_mjcf_in_place import numbers_of

import lieid_casadi as lieid
from lieid_casadi.cli.main import main

SIDES, JOINTS = ("left", "right"), ("left_1", "left_2", "right_1", "right_2")
INERTIA = 'ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"'


def mjcf_arm(side, y):
    link = '<inertial pos="0.1 0 0" mass="{}" diaginertia="0.01 0.01 0.01"/>'
    return (
        f'<body name="{side}_upper" pos="0 {y} 0"><joint name="{side}_1" axis="0 1 0"/>'
        f'{link.format(1.0)}<body name="{side}_fore" pos="0.3 0 0"><joint name="{side}_2" '
        f'axis="0 1 0"/>{link.format(0.5)}</body></body>'
    )


def urdf_arm(side, y):
    text, parent, origin = "", "base", f"0 {y} 0"
    for k, (name, mass) in enumerate((("upper", 1.0), ("fore", 0.5)), start=1):
        text += (
            f'<link name="{side}_{name}"><inertial><origin xyz="0.1 0 0"/><mass value="{mass}"/>'
            f'<inertia {INERTIA}/></inertial></link><joint name="{side}_{k}" type="revolute">'
            f'<origin xyz="{origin}"/><parent link="{parent}"/><child link="{side}_{name}"/>'
            '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="3"/></joint>'
        )
        parent, origin = f"{side}_{name}", "0.3 0 0"
    return text


def written(folder, to):
    """Write the file of both arms; return its path."""
    arm = mjcf_arm if to == "mjcf" else urdf_arm
    both = arm("left", 0.2) + arm("right", -0.2)
    texts = {
        "mjcf": f'<mujoco model="two"><worldbody>{both}</worldbody></mujoco>',
        "urdf": f'<robot name="two"><link name="base"/>{both}</robot>',
    }
    path = folder / {"mjcf": "two.xml", "urdf": "two.urdf"}[to]
    path.write_text(texts[to])
    return path


def torque_in_program(path, to, q, dq, ddq):
    """Torque of all four joints by MuJoCo or Pinocchio; damping is not part of Pinocchio's."""
    if to == "mjcf":
        model = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse.copy()
    model = pin.buildModelFromUrdf(str(path))
    assert list(model.names)[1:] == list(JOINTS)
    return pin.rnea(model, model.createData(), q, dq, ddq) + model.damping * dq


@pytest.mark.parametrize("to", ["mjcf", "urdf"])
def test_both_arms_are_in_one_file(to, tmp_path):
    source, fits = written(tmp_path, to), []
    for side, factors in zip(SIDES, ((1.3, 1.1), (0.9, 0.7)), strict=True):
        robot = lieid.Robot.load(source, tip=f"{side}_fore")
        fits.append(numbers_of(robot, "viscous", factors))
    first = lieid.export(fits[0], tmp_path / "left", to=to)
    fits[1].save(tmp_path / "right.json")
    words = ["export", str(tmp_path / "right.json"), "--to", to, "-o", str(tmp_path / "both")]
    assert main([*words, "--into", str(first.files[0])]) == 0
    (path,) = (tmp_path / "both").glob("two.*")
    q, dq, ddq = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 4))
    expected = [
        torque_of(fit, *(x[None, part] for x in (q, dq, ddq)))[0]
        for fit, part in zip(fits, (slice(0, 2), slice(2, 4)), strict=True)
    ]
    found = torque_in_program(path, to, q, dq, ddq)
    np.testing.assert_allclose(found, np.concatenate(expected), atol=1e-9)
