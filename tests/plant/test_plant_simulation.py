"""Integration, stick and slip, energy, control; trajectories and sensors."""

import numpy as np
import pinocchio as pin
import pytest
from plant.arms import arm_of, slider
from robot.random_arms import random_arm
from scipy.integrate import solve_ivp

from lieid_casadi import robots
from lieid_casadi.errors import RecordingError, RobotError
from lieid_casadi.plant import (
    BiasDrift,
    EncoderOffset,
    FourierTrajectory,
    LoadFriction,
    PositionFriction,
    Sensors,
    Stribeck,
    TorqueGain,
    demo_arm,
    demo_sensors,
    measure,
    move,
    move_along,
    simulate,
)
from lieid_casadi.plant.simulate import DriveCommand, Stepper

H = 1e-3


def _constant(torque):
    torque = np.asarray(torque, dtype=float)
    return DriveCommand(torque, np.zeros(torque.size), np.full(torque.size, np.inf))


def _run(stepper, torque, steps):
    command, cold = _constant(torque), np.full(stepper.q.size, 25.0)
    return [stepper.step(k * H, command, cold) for k in range(steps)]


@pytest.mark.parametrize(
    "effects",
    [
        (),
        (Stribeck(1, extra=2.0, velocity=0.05),),
        (LoadFriction(1, gain=0.2),),
        (PositionFriction(1, amplitude=0.3, phase=1.5),),
    ],
)
def test_friction_at_rest_holds_the_arm(effects):
    robot = robots.panda()
    arm = arm_of(robot, coulomb=3.0, offset=0.0, effects=effects)
    q0 = np.array([0.1, -0.5, 0.2, -1.8, 0.3, 1.5, 0.4])
    model = arm.rigid_model()
    gravity = pin.computeGeneralizedGravity(model, model.createData(), q0)
    pushes = 2.95 * np.array([1, -1, 1, -1, 1, -1, 1])
    stepper = Stepper(arm, H, q0)
    for push in (0.0, 0.5, 1.0, -1.0):
        rows = _run(stepper, gravity + push * pushes, 50)
        np.testing.assert_array_equal(stepper.q, q0)
        np.testing.assert_array_equal(stepper.dq, np.zeros(7))
        np.testing.assert_allclose(rows[-1].dry, push * pushes, atol=1e-9)
        assert rows[-1].resting.all()


def test_a_push_beyond_the_level_moves_the_arm():
    arm = arm_of(slider(), coulomb=3.0, viscous=0.0, offset=0.0)
    held, pushed = (Stepper(arm, H, np.zeros(1)) for _ in range(2))
    _run(held, [2.999], 100)
    _run(pushed, [-3.2], 100)
    assert held.q[0] == 0.0
    assert pushed.q[0] == pytest.approx(-0.5 * (0.2 / 2.0) * 0.1**2, rel=1e-6)


def test_a_sliding_mass_stops_where_friction_stops_it_and_stays():
    arm = arm_of(slider(mass=2.0), coulomb=3.0, viscous=0.0, offset=0.0)
    stepper = Stepper(arm, H, np.zeros(1))
    stepper.dq = np.array([0.75])
    rows = _run(stepper, [0.0], 700)
    assert stepper.dq[0] == 0.0
    assert stepper.q[0] == pytest.approx(0.75**2 * 2.0 / (2 * 3.0), abs=1e-6)
    speed = np.array([row.dq[0] for row in rows])
    assert np.all(speed >= 0.0)
    assert rows[-1].dry[0] == pytest.approx(0.0, abs=1e-9)


def _reference(arm, q0, dq0, torque, until):
    model = arm.rigid_model()
    data = model.createData()

    def rate(_, y):
        q, v = y[:7], y[7:]
        drive = torque - arm.friction.viscous * v - arm.friction.offset
        return np.concatenate([v, pin.aba(model, data, q, v, drive)])

    state = np.concatenate([q0, dq0])
    return solve_ivp(rate, (0, until), state, rtol=1e-11, atol=1e-12).y[:, -1]


def test_integration_is_of_second_order():
    arm = arm_of(robots.panda(), coulomb=0.0, viscous=0.8, offset=0.1)
    rng = np.random.default_rng(1)
    q0, dq0, torque = rng.normal(size=7), 0.3 * rng.normal(size=7), rng.normal(size=7)
    exact = _reference(arm, q0, dq0, torque, 0.2)
    errors = []
    for h in (2e-3, 1e-3, 5e-4):
        stepper = Stepper(arm, h, q0)
        stepper.dq = dq0.copy()
        for k in range(round(0.2 / h)):
            stepper.step(k * h, _constant(torque), np.full(7, 25.0))
        errors.append(np.abs(np.concatenate([stepper.q, stepper.dq]) - exact).max())
    assert errors[1] < 1e-2
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(order, 2.0, atol=0.3)


@pytest.mark.parametrize("hidden", ["stribeck", "load_friction"])
def test_friction_dissipates_and_energy_balances(hidden):
    arm = demo_arm(robots.two_link(), hidden=hidden, joint=1)
    motion = move(arm, FourierTrajectory(arm.robot, seed=3, base_frequency=0.4))
    moving = ~motion.resting
    assert np.all((motion.dry * motion.dq)[moving] >= -1e-12)
    model = arm.rigid_model()
    data = model.createData()

    def energy(k):
        kinetic = pin.computeKineticEnergy(model, data, motion.q[k], motion.dq[k])
        return kinetic + pin.computePotentialEnergy(model, data, motion.q[k])

    power = np.sum((motion.tau - motion.dry - motion.smooth) * motion.dq, axis=1)
    work = np.trapezoid(power, motion.t)
    absolute = np.trapezoid(np.abs(power), motion.t)
    assert work == pytest.approx(energy(-1) - energy(0), abs=1e-4 * absolute)


def test_measuring_along_the_simulated_motion_gives_its_torques():
    arm = demo_arm(robots.two_link(), hidden="presliding", joint=1)
    motion = move(arm, FourierTrajectory(arm.robot, seed=3, base_frequency=0.2))
    again = move_along(arm, motion.t, motion.q, motion.dq, motion.ddq)
    same = ~motion.resting & ~again.resting
    same[motion.t < 2.5] = False  # the state of presliding follows from the motion after some way
    np.testing.assert_allclose(again.tau[same], motion.tau[same], atol=1e-6)


def test_same_seed_same_recording():
    arm = demo_arm(robots.two_link(), seed=5)
    trajectory = FourierTrajectory(arm.robot, seed=3, base_frequency=2.0)
    sensors = demo_sensors(arm.robot)
    seen = []
    one, two, other = (
        simulate(arm, trajectory, sensors=sensors, seed=seed, progress=seen.append)
        for seed in (1, 1, 2)
    )
    assert seen[: len(seen) // 3] == sorted(seen[: len(seen) // 3])
    assert (seen[0], seen[-1]) == (0.0, 1.0)
    np.testing.assert_array_equal(one.tau, two.tau)
    np.testing.assert_array_equal(one.q, two.q)
    assert np.abs(one.tau - other.tau).max() > 0.0


ARMS = [robots.panda, robots.two_link, lambda: random_arm(np.random.default_rng(1), 5)]


def _fourier(robot):
    return FourierTrajectory(robot, harmonics=6, base_frequency=0.2, periods=2, seed=4)


@pytest.mark.parametrize("robot", [make() for make in ARMS], ids=lambda r: r.name)
def test_motion_is_feasible_smooth_and_rests_at_both_ends(robot):
    path = _fourier(robot)
    t = np.linspace(-0.5, path.duration + 0.5, 40001)
    q, dq, ddq = path.at(t)
    assert np.all(q >= robot.limit("position_lower") - 1e-9)
    assert np.all(q <= robot.limit("position_upper") + 1e-9)
    assert np.all(np.abs(dq) <= robot.limit("velocity"))
    acceleration = np.minimum(robot.limit("acceleration"), 5.0)
    assert np.all(np.abs(ddq) <= acceleration + 1e-9)
    assert np.abs(dq).max() > 0.2 * np.max(robot.limit("velocity")[1:2])
    outside = (t <= 0) | (t >= path.duration)
    assert not dq[outside].any()
    assert not ddq[outside].any()
    step = t[1] - t[0]
    np.testing.assert_allclose(np.gradient(q, step, axis=0), dq, atol=5 * step)
    np.testing.assert_allclose(np.gradient(dq, step, axis=0), ddq, atol=400 * step)


def test_fourier_trajectories_are_periodic_and_reproducible():
    robot = robots.panda()
    t = np.linspace(0.1, 4.9, 100)
    one = _fourier(robot)
    np.testing.assert_allclose(one.at(t)[0], one.at(t + 5.0)[0], atol=1e-12)
    np.testing.assert_array_equal(one.at(t)[0], _fourier(robot).at(t)[0])
    other = FourierTrajectory(robot, harmonics=6, base_frequency=0.2, seed=5)
    assert np.abs(one.at(t)[0] - other.at(t)[0]).max() > 0.1


def test_a_series_of_one_harmonic_is_refused():
    with pytest.raises(RobotError, match="expected at least 2"):
        FourierTrajectory(robots.two_link(), harmonics=1, seed=0)


ROBOT = robots.two_link()
T = np.arange(20001) / 1000.0
PATH = FourierTrajectory(ROBOT, seed=7, base_frequency=0.1, periods=2).at(T)


def _sampled(sensors, *effects, seed=0):
    arm = arm_of(ROBOT, effects=effects)
    return measure(arm, move_along(arm, T, *PATH), sensors, seed=seed)


TRUTH = move_along(arm_of(ROBOT), T, *PATH)


def test_ideal_sensors_measure_the_true_signals():
    recording = _sampled(Sensors(rate=None))
    np.testing.assert_array_equal(recording.t, T)
    np.testing.assert_array_equal(recording.q, TRUTH.q)
    np.testing.assert_array_equal(recording.dq, TRUTH.dq)
    np.testing.assert_array_equal(recording.tau, TRUTH.tau)
    assert recording.temperature is None


@pytest.mark.parametrize(("rate", "count", "steps"), [(125.0, 2501, {8}), (300.0, 6001, {3, 4})])
def test_the_nearest_instants_are_sampled_with_their_stamps(rate, count, steps):
    recording = _sampled(Sensors(rate=rate))
    assert len(recording) == count
    assert set(np.round(np.diff(recording.t) * 1000).astype(int)) == steps
    rows = np.round(recording.t * 1000).astype(int)
    np.testing.assert_array_equal(recording.q, TRUTH.q[rows])
    np.testing.assert_array_equal(recording.tau, TRUTH.tau[rows])


def test_a_rate_above_the_control_is_refused():
    with pytest.raises(RecordingError, match="sensors at 2000 Hz on a motion at 1000 Hz"):
        _sampled(Sensors(rate=2000.0))


def test_velocity_from_the_encoder():
    recording = _sampled(Sensors(rate=200.0, counts_per_turn=2**16, velocity="difference"))
    error = (recording.dq - TRUTH.dq[::5])[2:-2]
    bound = 2 * np.pi / 2**16 / 0.01
    assert np.abs(error).max() <= 1.1 * bound
    assert error.std() == pytest.approx(bound / np.sqrt(6), rel=0.15)
    assert _sampled(Sensors(velocity="none")).dq is None
    noisy = _sampled(Sensors(rate=None, velocity_noise=0.02))
    assert (noisy.dq - TRUTH.dq).std() == pytest.approx(0.02, rel=0.03)


def test_standard_deviation_of_white_noise():
    noise = _sampled(Sensors(rate=None, torque_noise=(0.3, 0.05))).tau - TRUTH.tau
    np.testing.assert_allclose(noise.std(axis=0), [0.3, 0.05], rtol=0.03)
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.03
    assert abs(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) < 0.03


@pytest.mark.parametrize("rate", [None, 100.0])
def test_coloured_noise_has_its_correlation_time(rate):
    sensors = Sensors(rate=rate, coloured_noise=0.2, correlation_time=0.03)
    recording = _sampled(sensors)
    rows = np.round(recording.t * 1000).astype(int)
    noise = recording.tau - TRUTH.tau[rows]
    assert noise.std() == pytest.approx(0.2, rel=0.1)
    step = recording.t[1] - recording.t[0]
    lag = np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]
    assert lag == pytest.approx(np.exp(-step / 0.03), abs=0.04)


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        (TorqueGain(1, gain=0.07), lambda q, tau: (q[1], 1.07 * tau[1])),
        (BiasDrift(1, rate=0.02), lambda q, tau: (q[1], tau[1] + 0.02 * (T - 10.0))),
        (EncoderOffset(1, offset=0.05), lambda q, tau: (q[1] - 0.05, tau[1])),
    ],
    ids=lambda x: getattr(x, "name", ""),
)
def test_effects_on_what_is_measured_change_their_joint_alone(effect, expected):
    recording = _sampled(Sensors(rate=None), effect)
    q, tau = expected(TRUTH.q.T, TRUTH.tau.T)
    np.testing.assert_allclose(recording.q, np.column_stack([TRUTH.q[:, 0], q]), atol=1e-12)
    np.testing.assert_allclose(recording.tau, np.column_stack([TRUTH.tau[:, 0], tau]), atol=1e-9)
