"""Sensors: rate, quantization, noise, and effects on what is measured."""

import numpy as np
import pytest
from plant.arms import arm_of

from lieid_casadi import robots
from lieid_casadi.errors import RecordingError
from lieid_casadi.plant import (
    BiasDrift,
    EncoderOffset,
    FourierTrajectory,
    Sensors,
    TorqueGain,
    measure,
    move_along,
)

ROBOT = robots.two_link()
T = np.arange(20001) / 1000.0
PATH = FourierTrajectory(ROBOT, seed=7, base_frequency=0.1, periods=2).at(T)


def _measure(sensors, *effects, seed=0):
    arm = arm_of(ROBOT, effects=effects)
    return measure(arm, move_along(arm, T, *PATH), sensors, seed=seed)


TRUTH = move_along(arm_of(ROBOT), T, *PATH)


def test_ideal_sensors_measure_the_true_signals():
    recording = _measure(Sensors(rate=None))
    np.testing.assert_array_equal(recording.t, T)
    np.testing.assert_array_equal(recording.q, TRUTH.q)
    np.testing.assert_array_equal(recording.dq, TRUTH.dq)
    np.testing.assert_array_equal(recording.tau, TRUTH.tau)
    assert recording.temperature is None


@pytest.mark.parametrize(("rate", "count", "steps"), [(125.0, 2501, {8}), (300.0, 6001, {3, 4})])
def test_the_nearest_instants_are_sampled_with_their_stamps(rate, count, steps):
    recording = _measure(Sensors(rate=rate))
    assert len(recording) == count
    assert set(np.round(np.diff(recording.t) * 1000).astype(int)) == steps
    rows = np.round(recording.t * 1000).astype(int)
    np.testing.assert_array_equal(recording.q, TRUTH.q[rows])
    np.testing.assert_array_equal(recording.tau, TRUTH.tau[rows])


def test_a_rate_above_the_control_is_refused():
    with pytest.raises(RecordingError, match="sensors at 2000 Hz on a motion at 1000 Hz"):
        _measure(Sensors(rate=2000.0))


def test_velocity_from_the_encoder():
    recording = _measure(Sensors(rate=200.0, counts_per_turn=2**16, velocity="difference"))
    error = (recording.dq - TRUTH.dq[::5])[2:-2]
    bound = 2 * np.pi / 2**16 / 0.01
    assert np.abs(error).max() <= 1.1 * bound
    assert error.std() == pytest.approx(bound / np.sqrt(6), rel=0.15)
    assert _measure(Sensors(velocity="none")).dq is None
    noisy = _measure(Sensors(rate=None, velocity_noise=0.02))
    assert (noisy.dq - TRUTH.dq).std() == pytest.approx(0.02, rel=0.03)


def test_standard_deviation_of_white_noise():
    noise = _measure(Sensors(rate=None, torque_noise=(0.3, 0.05))).tau - TRUTH.tau
    np.testing.assert_allclose(noise.std(axis=0), [0.3, 0.05], rtol=0.03)
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.03
    assert abs(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) < 0.03


@pytest.mark.parametrize("rate", [None, 100.0])
def test_coloured_noise_has_its_correlation_time(rate):
    sensors = Sensors(rate=rate, coloured_noise=0.2, correlation_time=0.03)
    recording = _measure(sensors)
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
    recording = _measure(Sensors(rate=None), effect)
    q, tau = expected(TRUTH.q.T, TRUTH.tau.T)
    np.testing.assert_allclose(recording.q, np.column_stack([TRUTH.q[:, 0], q]), atol=1e-12)
    np.testing.assert_allclose(recording.tau, np.column_stack([TRUTH.tau[:, 0], tau]), atol=1e-9)
