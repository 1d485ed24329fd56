"""The plant's rigid arm against MuJoCo and against the product of exponentials."""

import numpy as np
import pinocchio as pin
import pytest
from plant.arms import MujocoArm, arm_of, with_links
from robot.random_arms import random_arm, random_states
from scipy.linalg import expm

from lieid_casadi import robots
from lieid_casadi.plant import (
    BaseTilt,
    ExternalWrench,
    Payload,
    build_pinocchio,
    move_along,
    perturbed_inertias,
)
from lieid_casadi.robot.inertia import pseudo_inertia

ARMS = [robots.panda, robots.panda_luo2024, robots.two_link] + [
    pytest.param(lambda n=n: random_arm(np.random.default_rng(n), n), id=f"random_{n}")
    for n in (1, 2, 4, 6, 8)
]


@pytest.mark.parametrize("make", ARMS)
def test_torques_match_mujoco(make):
    robot = make()
    parameters = perturbed_inertias(robot, spread=0.2, seed=1)
    model = build_pinocchio(robot, parameters)
    data = model.createData()
    q, dq, ddq = random_states(np.random.default_rng(2), robot, 20)
    expected = MujocoArm(with_links(robot, parameters)).torques(q, dq, ddq)
    tau = np.array([pin.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
    np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("make", ARMS)
def test_tool_pose_and_jacobian_match_mujoco(make):
    robot = make()
    model = build_pinocchio(robot)
    data = model.createData()
    q = random_states(np.random.default_rng(3), robot, 1)[0][0]
    pin.framesForwardKinematics(model, data, q)
    pose = np.eye(4)
    for joint, angle in zip(robot.joints, q, strict=True):
        w, v = joint.screw[:3], joint.screw[3:]
        twist = np.zeros((4, 4))
        twist[:3, :3] = [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
        twist[:3, 3] = v
        pose = pose @ expm(twist * angle)
    pose = pose @ robot.joints[-1].home @ robot.tool
    frame = data.oMf[model.getFrameId("tool")].homogeneous
    np.testing.assert_allclose(frame, pose, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_perturbed_bodies_are_physical_and_near_the_nominal_ones(seed):
    robot = robots.panda()
    nominal = robot.link_parameters.reshape(-1, 10)
    links = perturbed_inertias(robot, spread=0.2, seed=seed).reshape(-1, 10)
    for link in links:
        assert np.linalg.eigvalsh(pseudo_inertia(link)).min() > 0
    ratio = links[:, 0] / nominal[:, 0]
    assert np.all((ratio >= 0.8) & (ratio <= 1.2))
    assert np.ptp(ratio) > 0.05
    np.testing.assert_array_equal(links.ravel(), perturbed_inertias(robot, spread=0.2, seed=seed))


@pytest.fixture
def path():
    """An arm without friction, a path, and its torques and MuJoCo twin."""
    robot = random_arm(np.random.default_rng(5), 6)
    q, dq, ddq = random_states(np.random.default_rng(6), robot, 10)
    arm = arm_of(robot, coulomb=0.0, viscous=0.0, offset=0.0)
    return arm, (np.arange(10) * 0.1, q, dq, ddq), MujocoArm(robot)


def test_external_wrench_adds_its_jacobian_transpose(path):
    arm, states, twin = path
    effect = ExternalWrench(moment=(1.0, -2.0, 3.0), force=(10.0, 20.0, -5.0))
    added = move_along(arm.with_effects(effect), *states).tau - move_along(arm, *states).tau
    wrench = np.array([1.0, -2.0, 3.0, 10.0, 20.0, -5.0])
    expected = [twin.tool(q)[2].T @ wrench for q in states[1]]
    np.testing.assert_allclose(added, expected, atol=1e-9)


def test_payload_adds_its_weight(path):
    arm, (t, q, dq, _), twin = path
    com, mass = np.array([0.05, -0.02, 0.1]), 1.5
    loaded = arm.with_effects(Payload(mass=mass, com=tuple(com), radius=0.02))
    still = (t, q, 0 * dq, 0 * dq)
    added = move_along(loaded, *still).tau - move_along(arm, *still).tau
    for row, pose in zip(added, q, strict=True):
        _, rotation, jacobian = twin.tool(pose)
        force = -mass * arm.robot.gravity
        wrench = np.concatenate([np.cross(rotation @ com, force), force])
        np.testing.assert_allclose(row, jacobian.T @ wrench, atol=1e-9)


def test_base_tilt_rotates_gravity(path):
    arm, *_ = path
    tilted = arm.with_effects(BaseTilt(about_x=0.1)).gravity
    x, y, z = arm.robot.gravity
    c, s = np.cos(0.1), np.sin(0.1)
    np.testing.assert_allclose(tilted, [x, c * y - s * z, s * y + c * z])
