import numpy as np
import pinocchio as pin
import pytest
from real_arms import PANDA, needs
from robot.random_arms import random_states, to_pinocchio

import lieid_casadi.robots as robots
from lieid_casadi.robot import Robot
from lieid_casadi.robot.inertia import pseudo_inertia

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
