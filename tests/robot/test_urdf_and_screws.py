"""An arm written as URDF and as YAML is the same robot."""

import numpy as np
import pinocchio as pin
import pytest
from robot.random_arms import (
    axis_in_link,
    mass_com_inertia,
    random_arm,
    random_states,
    to_pinocchio,
)
from scipy.spatial.transform import Rotation

from lieid_casadi.robot import Robot
from lieid_casadi.robot.yaml_file import write_yaml

EARTH = np.array([0.0, 0.0, -9.81])  # URDF states no gravity; this is Pinocchio's default


def urdf_of(robot):
    lines = [f'<robot name="{robot.name}"><link name="base"/>']
    before, parent = np.eye(4), "base"
    for joint in robot.joints:
        mass, com, inertia = mass_com_inertia(joint.link)
        kind = "revolute" if joint.screw[:3].any() else "prismatic"
        six = " ".join(
            f'{name}="{float(inertia[i, j])!r}"'
            for name, i, j in (
                ("ixx", 0, 0),
                ("ixy", 0, 1),
                ("iyy", 1, 1),
                ("ixz", 0, 2),
                ("iyz", 1, 2),
                ("izz", 2, 2),
            )
        )
        limits = joint.limits
        lines += [
            f'<joint name="{joint.name}" type="{kind}">',
            origin(np.linalg.solve(before, joint.home)),
            f'<parent link="{parent}"/><child link="{joint.link_name}"/>',
            f'<axis xyz="{text(axis_in_link(joint)[0])}"/>',
            f'<limit lower="{limits.position_lower}" upper="{limits.position_upper}" '
            f'velocity="{limits.velocity}" effort="{limits.torque}"/></joint>',
            f'<link name="{joint.link_name}"><inertial><origin xyz="{text(com)}"/>',
            f'<mass value="{float(mass)!r}"/><inertia {six}/></inertial></link>',
        ]
        before, parent = joint.home, joint.link_name
    lines += [
        f'<joint name="flange" type="fixed">{origin(robot.tool)}',
        f'<parent link="{parent}"/><child link="tool"/></joint><link name="tool"/></robot>',
    ]
    return "\n".join(lines)


def origin(pose):
    rpy = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")
    return f'<origin xyz="{text(pose[:3, 3])}" rpy="{text(rpy)}"/>'


def text(values):
    return " ".join(repr(float(value)) for value in values)


@pytest.mark.parametrize("seed", range(8))
def test_urdf_and_yaml_agree(seed, tmp_path):
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, 1 + seed, off_origin=False)
    (tmp_path / "arm.urdf").write_text(urdf_of(arm))
    (tmp_path / "arm.yaml").write_text(write_yaml(arm))
    one, two = Robot.load(tmp_path / "arm.urdf"), Robot.load(tmp_path / "arm.yaml")

    assert one.name == two.name
    np.testing.assert_allclose(one.tool, two.tool, rtol=0, atol=1e-12)
    for left, right in zip(one.joints, two.joints, strict=True):
        assert (left.name, left.revolute) == (right.name, right.revolute)
        for name in ("position_lower", "position_upper", "velocity", "torque"):
            assert getattr(left.limits, name) == getattr(right.limits, name)
        np.testing.assert_allclose(left.screw, right.screw, rtol=0, atol=1e-12)
        np.testing.assert_allclose(left.home, right.home, rtol=0, atol=1e-12)
        np.testing.assert_allclose(left.link, right.link, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_same_kinematics_and_torques_as_the_urdf_in_pinocchio(seed):
    """Pinocchio reads the URDF itself; the screws are read from YAML."""
    rng = np.random.default_rng(100 + seed)
    arm = random_arm(rng, 2 + seed, off_origin=False)
    theirs = pin.buildModelFromXML(urdf_of(arm))
    ours = to_pinocchio(Robot.parse_yaml(write_yaml(arm)))
    ours.gravity.linear = theirs.gravity.linear = EARTH
    for q, dq, ddq in zip(*random_states(rng, arm, 5), strict=True):
        torques, poses = [], []
        for model in (theirs, ours):
            data = model.createData()
            torques.append(pin.rnea(model, data, q, dq, ddq))
            pin.framesForwardKinematics(model, data, q)
            poses.append(data.oMf[model.getFrameId("tool")].homogeneous)
        scale = np.abs(torques[0]).max()
        np.testing.assert_allclose(torques[1], torques[0], rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(poses[1], poses[0], rtol=0, atol=1e-12)
