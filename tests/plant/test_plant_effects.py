"""The rigid arm against MuJoCo, and the torque of each hidden effect by its formula."""

import numpy as np
import pinocchio as pin
import pytest
from plant.arms import MujocoArm, arm_of, with_links
from robot.random_arms import random_arm, random_states
from scipy.linalg import expm

from lieid_casadi import robots
from lieid_casadi.errors import EffectError
from lieid_casadi.plant import (
    Arm,
    Armature,
    BaseTilt,
    ExternalWrench,
    ForeignTorque,
    FourierTrajectory,
    JointElasticity,
    LoadFriction,
    Payload,
    PositionFriction,
    PositionSpring,
    Presliding,
    Stribeck,
    TemperatureFriction,
    Thermal,
    TorqueRipple,
    TransmissionCoupling,
    ViscousAsymmetric,
    ViscousPolynomial,
    WarmUp,
    build_pinocchio,
    demo_arm,
    demo_sensors,
    hidden_effect,
    measure,
    move,
    move_along,
    perturbed_inertias,
)
from lieid_casadi.robot.inertia import pseudo_inertia

J, OTHER = 3, 4
COULOMB, VISCOUS, OFFSET = 0.5, 0.3, 0.1

# Effect, and what joint J's drive then takes: m is the motion, r its rigid torque on joint J.
FORMULAS = {
    "none": (None, lambda q, v, r, m: 0 * q),
    "viscous_polynomial": (
        ViscousPolynomial(J, quadratic=-0.2, cubic=0.1),
        lambda q, v, r, m: -0.2 * np.sign(v) * v**2 + 0.1 * v**3,
    ),
    "viscous_asymmetric": (
        ViscousAsymmetric(J, coefficient=0.2),
        lambda q, v, r, m: 0.2 * np.abs(v),
    ),
    "stribeck": (
        Stribeck(J, extra=0.8, velocity=0.1),
        lambda q, v, r, m: 0.8 * np.sign(v) * np.exp(-((v / 0.1) ** 2)),
    ),
    "load": (LoadFriction(J, gain=0.15), lambda q, v, r, m: 0.15 * np.abs(r) * np.sign(v)),
    "load, both terms": (
        LoadFriction(J, gain=0.1, extra=0.5, rate=0.02),
        lambda q, v, r, m: (
            np.sign(v) * (0.1 * np.abs(r) + 0.5 * np.exp(-0.02 * np.abs(r) / np.abs(v)))
        ),
    ),
    "position_friction": (
        PositionFriction(J, amplitude=0.3, harmonic=2.0, phase=0.4),
        lambda q, v, r, m: 0.3 * np.sin(2 * q + 0.4) * np.sign(v),
    ),
    "armature": (Armature(J, inertia=0.7), lambda q, v, r, m: 0.7 * m.ddq[:, J]),
    "torque_ripple": (
        TorqueRipple(J, amplitude=0.4, harmonic=7.0, phase=0.2),
        lambda q, v, r, m: 0.4 * np.sin(7 * q + 0.2),
    ),
    "position_spring": (
        PositionSpring(J, stiffness=2.0, rest=0.5),
        lambda q, v, r, m: 2.0 * (q - 0.5),
    ),
    "transmission_coupling": (
        TransmissionCoupling(J, source=OTHER, viscous_coefficient=0.4, coulomb=0.3),
        lambda q, v, r, m: (
            0.4 * m.dq[:, OTHER] + 0.3 * np.sign(m.dq[:, OTHER]) * ~m.resting[:, OTHER]
        ),
    ),
    "warm_up": (
        WarmUp(J, change=-0.4, time_constant=3.0),
        lambda q, v, r, m: -0.4 * (1 - np.exp(-m.t / 3.0)) * (COULOMB * np.sign(v) + VISCOUS * v),
    ),
    "temperature_friction": (
        TemperatureFriction(J, viscous_decay=0.05, dry_slope=0.02, reference=25.0),
        lambda q, v, r, m: (
            VISCOUS * v * (np.exp(-0.05 * (m.temperature[:, J] - 25.0)) - 1.0)
            - COULOMB * np.sign(v) * 0.02 * (m.temperature[:, J] - 25.0)
        ),
    ),
    "foreign": (
        ForeignTorque(J, function=lambda s: 0.3 * s.q[..., J] * s.dq[..., OTHER]),
        lambda q, v, r, m: 0.3 * q * m.dq[:, OTHER],
    ),
}


def _arm(effect):
    thermal = Thermal(start=25.0, rise=15.0, time_constant=4.0)
    effects = () if effect is None else (effect,)
    arm = arm_of(robots.panda(), coulomb=COULOMB, viscous=VISCOUS, offset=OFFSET, effects=effects)
    return Arm(arm.robot, arm.parameters, arm.friction, arm.effects, thermal)


def _residual(motion, robot):
    """τ less MuJoCo's rigid torque."""
    rigid = MujocoArm(robot).torques(motion.q, motion.dq, motion.ddq)
    return motion.tau - rigid, rigid


SIMULATED = ("none", "stribeck", "load, both terms", "armature", "temperature_friction")


@pytest.mark.parametrize(
    ("case", "simulated"),
    [*((case, False) for case in FORMULAS), *((case, True) for case in SIMULATED)],
)
def test_torque_is_the_rigid_torque_and_the_formula(case, simulated):
    effect, formula = FORMULAS[case]
    arm = _arm(effect)
    trajectory, t = (
        FourierTrajectory(arm.robot, seed=3, base_frequency=0.5),
        np.linspace(0.01, 1.99, 300),
    )
    motion = move(arm, trajectory) if simulated else move_along(arm, t, *trajectory.at(t))
    friction, rigid = _residual(motion, arm.robot)
    expected = OFFSET + COULOMB * np.sign(motion.dq) + VISCOUS * motion.dq
    with np.errstate(divide="ignore"):
        expected[:, J] += formula(motion.q[:, J], motion.dq[:, J], rigid[:, J], motion)
    moving = ~motion.resting & (motion.dq != 0.0)
    assert moving.mean() > (0.7 if simulated else 0.999)
    np.testing.assert_allclose(friction[moving], expected[moving], atol=1e-6 if simulated else 1e-8)


def test_presliding_matches_dahl():
    """Dahl's dz/dq = (1 − z·sgn q̇)/w has the solution 1 − 2·e^{−x/w} after a reversal."""
    arm = _arm(Presliding(J, width=0.02))
    t = np.linspace(0.0, 4.0, 4001)
    q = np.tile([0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0], (t.size, 1))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    forward = t <= 2.0
    q[:, J] += np.where(forward, 0.1 * t, 0.4 - 0.1 * t)
    dq[:, J] = np.where(forward, 0.1, -0.1)
    dry = move_along(arm, t, q, dq, ddq).dry[:, J]
    way = np.where(forward, 0.1 * t, 0.1 * (t - 2.0))
    full = 1.0 - np.exp(-0.2 / 0.02)
    z = np.where(forward, 1.0 - np.exp(-way / 0.02), -1.0 + (1.0 + full) * np.exp(-way / 0.02))
    np.testing.assert_allclose(dry, COULOMB * z, atol=1e-9)
    coarse = move_along(arm, t[::50], q[::50], dq[::50], ddq[::50]).dry[:, J]
    np.testing.assert_allclose(coarse, dry[::50], atol=1e-9)


def test_elastic_joint_deflects_in_proportion_to_torque():
    arm = _arm(JointElasticity(J, stiffness=2000.0))
    trajectory = FourierTrajectory(arm.robot, seed=3, base_frequency=0.25)
    with pytest.raises(EffectError, match="expected measure_along"):
        move(arm, trajectory)
    t = np.linspace(0.0, 4.0, 2001)
    motion = move_along(arm, t, *trajectory.at(t))
    _, rigid = _residual(motion, arm.robot)
    lead = motion.motor_q - motion.q
    np.testing.assert_allclose(lead[:, J], rigid[:, J] / 2000.0, atol=1e-9)
    assert np.abs(lead[:, J]).max() > 1e-3
    assert np.all(np.delete(lead, J, axis=1) == 0.0)
    slope = np.gradient(motion.motor_q[:, J], motion.t)
    np.testing.assert_allclose(motion.motor_dq[5:-5, J], slope[5:-5], atol=5e-4)
    recording = measure(arm, motion, demo_sensors(arm.robot))
    step = 2 * np.pi / 2**19
    rows = np.searchsorted(motion.t, recording.t)
    np.testing.assert_allclose(recording.q, motion.motor_q[rows], atol=step)


def test_unknown_effects_and_joints_are_refused():
    arm = demo_arm(robots.two_link(), hidden=None)
    with pytest.raises(EffectError, match="expected one of armature"):
        hidden_effect(arm, "warp", 0)
    with pytest.raises(EffectError, match=r"joint 2 \(from 0\), but robot 'two_link' has 2"):
        arm.with_effects(Armature(2, inertia=1.0))


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
