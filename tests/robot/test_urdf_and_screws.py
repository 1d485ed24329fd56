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


@pytest.mark.parametrize("seed", range(0, 8, 2))
def test_kinematics_and_torques_are_those_of_pinocchio_reading_the_urdf(seed):
    rng = np.random.default_rng(100 + seed)
    arm = random_arm(rng, 2 + seed, off_origin=False)
    text = urdf_of(arm)
    theirs, ours = pin.buildModelFromXML(text), to_pinocchio(Robot.parse_urdf(text))
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


@pytest.mark.parametrize("tip", ["hand", "left"])
def test_locked_joints_and_branches_are_lumped_as_pinocchio_does(tip):
    """A hand with two fingers, one of them turned, and a mass beside a fixed joint."""
    body = (
        '<link name="{0}"><inertial><origin xyz="0.1 {1} 0.02" rpy="0.3 0 {1}"/><mass value="{1}"/>'
        '<inertia ixx="2" ixy="0.1" ixz="0.2" iyy="3" iyz="0.3" izz="4"/></inertial></link>'
    )
    joint = (
        '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>'
        '<origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/><axis xyz="0 0.6 0.8"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    links = [("arm", 3), ("hand", 2), ("left", 0.5), ("right", 0.7), ("camera", 0.2)]
    joints = [
        ("turn", "revolute", "base", "arm"), ("wrist", "prismatic", "arm", "hand"),
        ("l", "prismatic", "hand", "left"), ("r", "revolute", "hand", "right"),
        ("screwed", "fixed", "right", "camera"),
    ]  # fmt: skip
    parts = [body.format(*x) for x in links] + [joint.format(*x) for x in joints]
    text = f'<robot name="r"><link name="base"/>{"".join(parts)}</robot>'
    ours = to_pinocchio(Robot.parse_urdf(text, tip=tip, lock=["l", "r"]))
    full = pin.buildModelFromXML(text)
    theirs = pin.buildReducedModel(full, [full.getJointId(x) for x in "lr"], np.zeros(full.nq))
    rng = np.random.default_rng(0)
    for q, dq, ddq in rng.uniform(-1.0, 1.0, (5, 3, 2)):
        expected = pin.rnea(theirs, theirs.createData(), q, dq, ddq)
        found = pin.rnea(ours, ours.createData(), q, dq, ddq)
        np.testing.assert_allclose(found, expected, atol=1e-12)
    data, own = theirs.createData(), ours.createData()
    pin.framesForwardKinematics(theirs, data, q)
    pin.framesForwardKinematics(ours, own, q)
    pose = data.oMf[theirs.getFrameId(tip, pin.FrameType.BODY)].homogeneous
    np.testing.assert_allclose(own.oMf[ours.getFrameId("tool")].homogeneous, pose, atol=1e-12)
