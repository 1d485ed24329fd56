"""An arm written as URDF and as YAML is the same robot; the bundled arms."""

import numpy as np
import pinocchio as pin
import pytest
from real_arms import PANDA, needs
from robot.random_arms import (
    axis_in_link,
    mass_com_inertia,
    random_arm,
    random_states,
    to_pinocchio,
)
from scipy.spatial.transform import Rotation

import lieid_casadi.robots as robots
from lieid_casadi.robot import Robot
from lieid_casadi.robot.inertia import pseudo_inertia


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


D1, D3, D5, A4, A7, DF = 0.333, 0.316, 0.384, 0.0825, 0.088, 0.107
TABLE_2_SCREWS = [
    [0, 0, 1, 0, 0, 0],
    [0, 1, 0, -D1, 0, 0],
    [0, 0, 1, 0, 0, 0],
    [0, -1, 0, D1 + D3, 0, -A4],
    [1, 0, 0, 0, D1 + D3 + A4, 0],
    [0, -1, 0, D1 + D3 + A4, 0, -D5 - A4],
    [0, 0, -1, 0, D5 + A4 + A7, 0],
]
# q of Table II = q of Franka + this (see the YAML file for the signs that are printed)
SHIFT = np.array([0, 0, 0, np.pi / 2, 0, -np.pi / 2, 0])


def tool_at(robot, q):
    model = to_pinocchio(robot)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId("tool")].homogeneous


@pytest.mark.parametrize("name", ["panda", "panda_luo2024", "so101", "two_link"])
def test_bundled_robots_load_by_name_and_are_physically_possible(name):
    robot = Robot.load(name)
    assert robot.name == name
    assert robot.has_inertia
    np.testing.assert_array_equal(robot.link_parameters, getattr(robots, name)().link_parameters)
    for joint in robot.joints:
        assert np.linalg.eigvalsh(pseudo_inertia(joint.link)).min() > 0
    for limit in ("position_lower", "position_upper", "velocity", "torque"):
        assert np.isfinite(robot.limit(limit)).all()


def test_screws_of_table_2():
    robot = robots.panda_luo2024()
    screws = np.array([joint.screw for joint in robot.joints])
    np.testing.assert_allclose(screws, TABLE_2_SCREWS, rtol=0, atol=1e-12)


def test_reference_configuration_of_table_2():
    expected = np.eye(4)
    expected[:3, 3] = [D5 + A4 + A7, 0, D1 + D3 + A4 - DF]
    pose = tool_at(robots.panda_luo2024(), np.zeros(7))
    np.testing.assert_allclose(pose, expected, rtol=0, atol=1e-12)


def test_flange_of_franka_at_its_zero_pose():
    expected = np.diag([1.0, -1.0, -1.0, 1.0])
    expected[:3, 3] = [A7, 0, D1 + D3 + D5 - DF]
    np.testing.assert_allclose(tool_at(robots.panda(), np.zeros(7)), expected, rtol=0, atol=1e-12)


def test_one_arm_two_zero_poses():
    """The same physical state gives the same torques and the same pose of the tool."""
    franka, luo = robots.panda(), robots.panda_luo2024()
    models = [to_pinocchio(franka), to_pinocchio(luo)]
    for q, dq, ddq in zip(*random_states(np.random.default_rng(0), franka, 20), strict=True):
        torques = [
            pin.rnea(model, model.createData(), angles, dq, ddq)
            for model, angles in zip(models, (q, q + SHIFT), strict=True)
        ]
        np.testing.assert_allclose(torques[1], torques[0], rtol=0, atol=1e-12)
        poses = tool_at(franka, q), tool_at(luo, q + SHIFT)
        np.testing.assert_allclose(poses[0][:3, 3], poses[1][:3, 3], rtol=0, atol=1e-12)


@pytest.mark.real
@needs(PANDA / "panda.urdf")
def test_panda_is_the_public_urdf_without_its_hand():
    ours = robots.panda()
    theirs = Robot.load(
        PANDA / "panda.urdf",
        tip="panda_link8",
        lock=["panda_finger_joint1", "panda_finger_joint2"],
    )
    np.testing.assert_allclose(ours.tool, theirs.tool, rtol=0, atol=1e-12)
    for mine, other in zip(ours.joints, theirs.joints, strict=True):
        assert mine.name == other.name
        np.testing.assert_allclose(mine.screw, other.screw, rtol=0, atol=1e-12)
        np.testing.assert_allclose(mine.home, other.home, rtol=0, atol=1e-12)
        for limit in ("position_lower", "position_upper", "velocity", "torque"):
            assert getattr(mine.limits, limit) == getattr(other.limits, limit)
    for mine, other in zip(ours.joints[:6], theirs.joints[:6], strict=True):
        np.testing.assert_allclose(mine.link, other.link, rtol=0, atol=1e-14)
    # The URDF's last link carries hand and fingers, 0.73 + 2·0.015 kg.
    assert theirs.joints[6].link[0] - ours.joints[6].link[0] == pytest.approx(0.76)
