"""The torque limit: by a fit with its uncertainty, and by stated inertias with an allowance."""

from dataclasses import replace

import numpy as np
import pytest
from exporters.c_arms import made_fit, torque_of

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation import Torque, excite
from lieid_casadi.excitation.sample_functions import FittedArm
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.plant.arm import perturbed_inertias
from lieid_casadi.robot.drive import Drive

N = 2
EFFECTS = ["coulomb", "viscous", "offset", "stribeck:1", "load_friction:2", "presliding:1"]


@pytest.fixture(scope="module")
def robot():
    """The two-link arm with torque limits that a heavy arm with friction comes close to."""
    joints = [
        replace(joint, limits=replace(joint.limits, torque=limit))
        for joint, limit in zip(lieid.robots.two_link().joints, (20.0, 6.0), strict=True)
    ]
    return replace(lieid.robots.two_link(), joints=tuple(joints))


@pytest.fixture(scope="module")
def arm(robot):
    """A simulated arm with 30 % more mass than stated, and with friction."""
    links = 1.3 * perturbed_inertias(robot, spread=0.1, seed=1)
    friction = plant.JointFriction(np.array([2.0, 0.8]), np.array([1.0, 0.5]), np.zeros(N))
    return plant.Arm(robot, links, friction)


def run(arm, motion, seed):
    return plant.measure_along(
        arm, motion.t, motion.q, motion.dq, motion.ddq, sensors=plant.demo_sensors(arm.robot),
        seed=seed,
    )  # fmt: skip


@pytest.fixture(scope="module")
def fit(robot, arm):
    t = np.arange(0.0, 20.0, 0.005)
    motion = plant.FourierTrajectory(robot, base_frequency=0.1, seed=3).at(t)
    model = lieid.Model(robot, ["coulomb", "viscous", "offset"])
    return lieid.identify(model, run(arm, MotionSamples(t, *motion), 3))


def certain(fit):
    """The numbers of a fit without their uncertainty."""
    numbers = FittedArm.of(fit)
    return replace(numbers, covariance_root=np.zeros_like(numbers.covariance_root))


def test_the_torque_on_the_arm_stays_within_the_limit(robot, arm, fit):
    """Rigid torque within the limit is not enough; the fit's torque with its uncertainty is."""
    options = {
        "duration": 6.0, "starts": 1, "acceleration": 8.0, "margin": 1.0, "start_pose": [0.0, 0.0],
    }  # fmt: skip
    limit = robot.limit("torque")
    rigid = excite(fit.model, limits=[Torque(dry=0.0, viscous=0.0)], **options)
    safe = excite(fit, limits=[Torque()], **options)
    largest = [
        (np.abs(run(arm, found.motion(500.0), 5).tau).max(axis=0) / limit).max()
        for found in (rigid, safe)
    ]
    assert largest[0] > 1.1  # which optimum is found depends on rounding
    assert 0.9 < largest[1] < 1.015  # noise of 0.3 % of the limit
    assert any("by the fit with all effects, ± 2" in text for text in safe.checked)
    assert any("by the stated inertias" in text for text in rigid.checked)


@pytest.mark.parametrize(
    "effects",
    [
        ["coulomb", "viscous", "offset", "stribeck:1", "load_friction:2", "torque_gain:1"],
        ["viscous", "coulomb:2", "presliding:1", "payload", "warm_up:2"],
    ],
)
def test_the_bounds_contain_the_torque_of_the_fit(robot, arm, effects):
    """At every velocity, reversals included; where neither is near, they are the torque."""
    t = np.arange(0.0, 10.0, 0.005)
    along = MotionSamples(t, *plant.FourierTrajectory(robot, base_frequency=0.3, seed=4).at(t))
    other = lieid.identify(lieid.Model(robot, effects), run(arm, along, 4))
    limits = Torque().on(robot, certain(other))
    rng = np.random.default_rng(2)
    q, dq, ddq = (rng.uniform(-2.0, 2.0, (200, N)) for _ in range(3))
    dq[:100] *= 0.01
    largest, smallest = np.split(limits.values(MotionSamples(t[:200], q, dq, ddq)), 2)
    inverse = lieid.symbolic(other).inverse_dynamics
    width = next((x for x in other.shapes[:1] if other.model.states), 0.0)
    for part in (-1.0, 0.3, 1.0):  # of the deflection of the presliding
        named = {
            "q": q.T, "dq": dq.T, "ddq": ddq.T, "time": t[None, :200],
            "states": np.full((1, 200), part * width),
        }  # fmt: skip
        torque = inverse(*(named[name] for name in inverse.name_in())).full()
        assert np.all(torque <= largest + 1e-9)
        assert np.all(torque >= smallest - 1e-9)
    if not other.model.states:
        far = (np.abs(dq) > 0.1).all(axis=1)
        np.testing.assert_allclose(largest[:, far], smallest[:, far], atol=5e-9)
        np.testing.assert_allclose(largest[:, far], torque[:, far], atol=5e-9)


def test_the_bounds_contain_the_torque_of_bristles(robot):
    """LuGre: the deflection of slow sliding lasts beyond the reversal, and σ1·ż acts."""
    fit = made_fit(robot, "viscous,presliding/lugre")
    t = np.arange(0.0, 20.0, 5e-4)
    motion = MotionSamples(t, *plant.FourierTrajectory(robot, base_frequency=0.2, seed=4).at(t))
    limits = Torque().on(robot, certain(fit))
    largest, smallest = np.split(limits.values(motion), 2)
    torque = torque_of(fit, motion.q, motion.dq, motion.ddq, time=t).T
    assert np.all(torque <= largest + 1e-6)
    assert np.all(torque >= smallest - 1e-6)
    assert np.all(np.mean(largest - smallest, axis=1) < 5.0 * fit.effect_coefficients[2::2])


def test_two_standard_deviations_of_the_fit_are_added(robot, fit):
    rng = np.random.default_rng(0)
    q, dq, ddq = (rng.uniform(0.1, 2.0, (50, N)) for _ in range(3))  # far from reversals
    motion = MotionSamples(np.zeros(50), q, -dq, ddq)
    plain, wide = (
        Torque().on(robot, numbers).values(motion) for numbers in (certain(fit), FittedArm.of(fit))
    )
    rows = lieid.compile(fit.model).base_regressor(motion.q, motion.dq, motion.ddq)
    expected = 2.0 * np.sqrt(np.einsum("knp,pq,knq->kn", rows, fit.covariance, rows)).T
    np.testing.assert_allclose(wide - plain, np.concatenate([expected, -expected]), rtol=1e-6)
    torque = torque_of(fit, motion.q, motion.dq, motion.ddq).T
    np.testing.assert_allclose(plain, np.concatenate([torque, torque]), atol=5e-9)


def test_the_jacobian_of_a_fit(robot, fit):
    rng = np.random.default_rng(1)
    signals = [rng.uniform(-1.0, 1.0, (40, N)) for _ in range(3)]
    signals[1][:20] *= 0.02  # near reversals
    limits = Torque().on(robot, FittedArm.of(fit))
    slopes = limits.jacobian(MotionSamples(np.zeros(40), *signals))
    for k in range(3 * N):
        change = [np.zeros((40, N)) for _ in range(3)]
        change[k // N][:, k % N] = 1e-6
        after, before = (
            limits.values(
                MotionSamples(
                    np.zeros(40), *(x + s * d for x, d in zip(signals, change, strict=True))
                )
            )
            for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(slopes[:, k], (after - before) / 2e-6, atol=1e-5)


def test_the_allowance_for_friction(robot):
    """Rigid torque of Pinocchio, with 0.1 of the limit and 0.4 at the velocity limit."""
    import pinocchio as pin

    from lieid_casadi.robot.pinocchio_model import build_pinocchio

    model = build_pinocchio(robot)
    data = model.createData()
    limits, torque = Torque(0.8).on(robot), robot.limit("torque")
    q, dq, ddq = np.array([0.4, -0.3]), 0.5 * robot.limit("velocity"), np.array([1.0, 2.0])
    values = limits.values(MotionSamples(np.zeros(1), q[None], dq[None], ddq[None]))[:, 0]
    rigid = pin.rnea(model, data, q, dq, ddq)
    np.testing.assert_allclose(values, np.concatenate([rigid, rigid + 0.4 * 0.5 * torque]))
    np.testing.assert_allclose(limits.upper, np.tile(0.7 * torque, 2))
    with pytest.raises(
        ExcitationError, match=r"0.05 of the robot's, of which 0.1 is the allowance"
    ):
        Torque(0.05).on(robot)


def test_torques_in_units_of_a_stiffness_have_no_limit(robot):
    """They are not in N·m; the torque is then listed as unchecked."""
    relative = robot.with_drives(Drive(stiffness=1.0, relative=True))
    found = excite(lieid.Model(relative), duration=6.0, starts=1, max_iterations=10)
    assert "torque of every joint" in found.unchecked
    with pytest.raises(ExcitationError, match="states no torque limits"):
        Torque().on(relative)


def test_a_covariance_that_is_not_finite_is_refused(fit):
    broken = replace(fit, covariance=np.full_like(fit.covariance, np.inf))
    with pytest.raises(ExcitationError, match="covariance of the fit is not finite"):
        excite(broken, starts=1)
