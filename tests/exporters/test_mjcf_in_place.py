"""A fit written into the user's own model changes its numbers alone; two arms in one file."""

import dataclasses
import difflib
import re
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from exporters.c_arms import made_fit, torque_of
from exporters.test_mjcf_export import inverse

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.errors import NotReadWarning
from lieid_casadi.exporters.mjcf import mjcf_files
from lieid_casadi.identification.feasible.certificate import Certificate

ARM = """<?xml version="1.0"?>
<!-- a bench arm; do not lose this -->
<mujoco model='bench'>
  <compiler angle="degree" autolimits="true"/>
  <option timestep="0.004" gravity="0 0 -9.81"/>
  <default>
    <default class="arm">
      <joint axis="0 0 1" damping="0.6" armature="0.03"/>
      <position kp="40" dampratio="1" forcerange="-9 9"/>
      <default class="wrist">
        <joint frictionloss="0.05" solreffriction="0.03 1"/><position kp="20"/></default>
    </default>
    <default class="visual"><geom contype="0" conaffinity="0" group="2"/></default>
  </default>
  <worldbody>
    <light pos="0 0 2"/>
    <body name="base" childclass="arm">
      <geom type="cylinder" size="0.05 0.1" mass="4"/>
      <camera name="eye" pos="1 0 1"/>
      <!-- the shoulder > moves -->
      <body name="upper" pos="0 0 0.2" euler="80 0 0">
        <joint name="shoulder" range="-100 100" stiffness="0.2"/>
        <inertial pos="0.1 0 0.01" mass="1.5" diaginertia="0.01 0.02 0.02" quat="1 0.1 0 0"/>
        <geom class="visual" type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>
        <site name="mark" pos="0.1 0 0"/>
        <body name="fore" pos="0.3 0 0">
          <joint class="wrist" name="elbow" range="-120 120"
                 damping='0.4'/>
          <geom name="bar" type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.7"/>
          <include file="hand.xml"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position class="arm" name="a" joint="shoulder" ctrlrange="-100 100"/>
    <position class="wrist" name="b" joint="elbow" gear="2" dampratio="0.5"/>
    <position name="grip" joint="finger" kp="5"/>
  </actuator>
  <sensor><jointpos joint="elbow"/><accelerometer site="mark"/></sensor>
  <keyframe><key name="home" qpos="0.1 0.2 0.01"/></keyframe>
</mujoco>
"""
HAND = """<mujoco>
  <body name="palm" pos="0.25 0 0"><inertial pos="0 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>
    <body name="jaw"><joint name="finger" type="slide" axis="0 1 0" range="0 0.03"/>
      <inertial pos="0.02 0 0" mass="0.05" fullinertia="1e-5 2e-5 2e-5 0 0 0"/>
      <geom class="visual" type="box" size="0.01 0.01 0.01"/></body></body>
</mujoco>
"""
#: What an export may change, by tag.
CHANGED = {
    "inertial": {"pos", "mass", "fullinertia", "diaginertia", "quat"},
    "joint": {
        "armature", "damping", "frictionloss", "stiffness", "springref",
        "solreffriction", "solimpfriction",
    },
    "position": {"kp", "kv", "dampratio", "forcerange", "delay", "nsample"},
}  # fmt: skip
EFFECTS = "armature,coulomb,viscous,command_delay:2,position_spring:1,offset:1"


@pytest.fixture
def robot(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "hand.xml").write_text(HAND)
    return lieid.Robot.load(tmp_path / "arm.xml", tip="fore")


def exported(fit, folder):
    """Write the model of a fit; return its path and notes."""
    files, notes = mjcf_files(fit)
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder / next(iter(files)), notes


def numbers_of(robot, effects="", factors=(1.3, 1.1)):
    """Return a fit whose links are heavier or lighter than the robot's description states."""
    fit = made_fit(robot, effects)
    own = fit.parameters.copy()
    own[:20] = robot.link_parameters * np.repeat(factors, 10)
    ones = np.ones(2)
    certificate = Certificate(1.0, "given", ones, 1.0, 1, 1.0, ones, ones, ones)
    values = fit.model.base.combination @ own
    return dataclasses.replace(fit, parameters=own, values=values, certificate=certificate)


def test_nothing_else_changes(robot, tmp_path):
    fit = numbers_of(robot.with_drives(lieid.servo_drive("sts3215")), EFFECTS)
    path, _ = exported(fit, tmp_path / "out")
    for name, before in (("arm.xml", ARM), ("hand.xml", HAND)):
        after = (path.parent / name).read_text()
        one, other = (list(ElementTree.fromstring(text).iter()) for text in (before, after))
        stated = [e for e in one if e.tag != "inertial"]
        found = [e for e in other if e.tag != "inertial"]
        assert [e.tag for e in stated] == [e.tag for e in found]
        for was, now in zip(stated, found, strict=True):
            may = CHANGED.get(was.tag, set())
            kept = {k: v for k, v in was.attrib.items() if k not in may}
            assert kept == {k: v for k, v in now.attrib.items() if k not in may}
        tags = re.compile(r"<(inertial|joint|position)\b[^>]*>")
        changed = difflib.unified_diff(
            *(tags.sub("", text).split() for text in (before, after)), n=0
        )
        assert list(changed) == []


@pytest.mark.parametrize("saved", [False, True])
def test_motion_is_that_of_the_fit(robot, tmp_path, saved):
    fit = numbers_of(robot.with_drives(lieid.servo_drive("sts3215")), EFFECTS)
    if saved:
        fit.save(tmp_path / "fit.json")
        fit = lieid.Fit.load(tmp_path / "fit.json")
    path, notes = exported(fit, tmp_path / "out")
    assert not any("keeps what is not part" in note for note in notes)
    model = mujoco.MjModel.from_xml_path(str(path))
    np.testing.assert_allclose(model.dof_solref[:2], [[0.008, 1.0], [0.03, 1.0]])  # elbow: stated
    assert any("command delays" in note for note in notes)
    law, own = lieid.servo_drive("sts3215"), {}
    for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True):
        own[column.label] = value
    gear = np.array([1.0, 2.0])
    np.testing.assert_allclose(model.actuator_gainprm[:2, 0] * gear**2, law.stiffness)
    np.testing.assert_allclose(model.actuator_biasprm[:2, 1] * gear**2, -law.stiffness)
    np.testing.assert_allclose(model.actuator_biasprm[:2, 2], 0.0)
    np.testing.assert_allclose(model.actuator_forcerange[:2, 1] * gear, law.proportional_limit)
    late = own["command_delay.delta:2"] + 0.5 * model.opt.timestep  # as the integration is early
    assert model.actuator_delay[1] == pytest.approx(late)
    np.testing.assert_allclose(
        model.dof_frictionloss[:2], [own["coulomb.f_c:1"], own["coulomb.f_c:2"]]
    )
    model.dof_armature += 0.5 * model.opt.timestep * model.dof_damping  # as the integration does
    model.dof_damping[:2] -= law.damping
    model.dof_frictionloss[:] = 0.0
    random = np.random.default_rng(0)
    for q, dq, ddq in random.uniform(-1.5, 1.5, (20, 3, 2)):
        state = [np.append(x, 0.0) for x in (q, dq, ddq)]
        state[0][2] = 0.01  # of the finger, as in the first keyframe
        motion = q[None], dq[None], ddq[None]
        expected = fit.compiled.inverse_dynamics(*motion, fit.link_parameters)[0]
        for name, signal in (("armature.I_a", ddq), ("viscous.f_v", dq)):
            expected += [own[f"{name}:1"] * signal[0], own[f"{name}:2"] * signal[1]]
        expected[0] += own["position_spring.K:1"] * q[0] + own["offset.f_b:1"]
        np.testing.assert_allclose(inverse(model, *state)[:2], expected, rtol=1e-6, atol=1e-6)


def test_what_was_not_read_stays_and_is_noted(robot, tmp_path):
    fit = numbers_of(robot)
    unread = NotReadWarning("arm.xml: not read: gravcomp = 1 of body upper")
    _, notes = exported(dataclasses.replace(fit, warnings=(unread,)), tmp_path / "out")
    assert any("gravcomp = 1 of body upper" in note for note in notes)


def test_bodies_on_a_link_that_weigh_too_much_are_scaled(robot, tmp_path):
    fit = numbers_of(robot, factors=(1.0, 0.2))
    path, notes = exported(fit, tmp_path / "out")
    assert any("attached to it were scaled" in note for note in notes)
    model = mujoco.MjModel.from_xml_path(str(path))
    q = np.array([0.3, -0.4, 0.01])
    expected = fit.compiled.inverse_dynamics(
        q[None, :2], 0 * q[None, :2], 0 * q[None, :2], fit.link_parameters
    )
    model.jnt_stiffness[:] = 0.0
    np.testing.assert_allclose(inverse(model, q, 0 * q, 0 * q)[:2], expected[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (('body name="upper"', "body"), "give the links' bodies names"),
        (('angle="degree"', 'angle="degree" inertiafromgeom="true"'), "inertiafromgeom"),
    ],
)
def test_a_model_that_cannot_be_edited_is_written_anew(tmp_path, change, reason):
    (tmp_path / "arm.xml").write_text(ARM.replace(*change))
    (tmp_path / "hand.xml").write_text(HAND)
    robot = lieid.Robot.load(tmp_path / "arm.xml", tip="fore")
    files, notes = mjcf_files(numbers_of(robot))
    assert list(files) == ["bench.xml"]
    assert reason in notes[0]


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
        return inverse(mujoco.MjModel.from_xml_path(str(path)), q, dq, ddq)
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
