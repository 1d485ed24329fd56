"""Friction curves of the plant, whose friction does not use the library's effects."""

from dataclasses import replace

import numpy as np
import pytest
from exporters.c_arms import made_fit
from friction_curves.friction_plant import CUTOFF, ROBOT, SPEEDS, arm, friction, measured
from plant.motions import constant_speeds

from lieid_casadi import plant
from lieid_casadi.errors import RecordingError
from lieid_casadi.friction_curves import friction_curve


@pytest.fixture(scope="module")
def sweep():
    motion = constant_speeds(ROBOT, 0, speeds=SPEEDS, pose=[0.0, 0.4])
    t = np.arange(0.0, motion.duration, 0.004)
    return measured(t, motion.at(t))


@pytest.fixture(scope="module")
def curve(sweep):
    return friction_curve(ROBOT, sweep, 0, processing=CUTOFF)


def test_constant_speeds_give_the_friction_of_the_plant(curve):
    error = curve.friction - friction(curve.speed, curve.load)
    assert np.median(np.abs(error)) < 1e-3
    assert np.abs(error / curve.std).max() < 4.0
    assert np.mean(np.abs(error) < 2 * curve.std) > 0.9


def test_offset_and_asymmetric_friction_are_not_in_the_curve(sweep):
    even = arm(plant.ViscousAsymmetric(0, 0.5), offset=-2.0)
    motion = constant_speeds(ROBOT, 0, speeds=SPEEDS, pose=[0.0, 0.4])
    t = np.arange(0.0, motion.duration, 0.004)
    fit = replace(made_fit(ROBOT, ""), parameters=arm().parameters)
    other = friction_curve(fit, measured(t, motion.at(t), hidden=even), 0, processing=CUTOFF)
    same = friction_curve(fit, sweep, 0, processing=CUTOFF)
    assert (same.load_source, other.load_source) == ("model", "model")
    np.testing.assert_allclose(other.friction, same.friction, atol=0.02)


def lopsided(t):
    """Forward and backward motion with different accelerations at equal positions."""
    phase = 2 * np.pi * 0.15 * t
    q, dq, ddq = (np.zeros((len(t), 2)) for _ in range(3))
    w = 2 * np.pi * 0.15
    q[:, 0] = 0.8 * np.sin(phase) + 0.15 * np.sin(2 * phase)
    dq[:, 0] = w * (0.8 * np.cos(phase) + 0.3 * np.cos(2 * phase))
    ddq[:, 0] = w**2 * (-0.8 * np.sin(phase) - 0.6 * np.sin(2 * phase))
    return q, dq, ddq


def test_any_motion_in_both_directions_with_different_accelerations():
    """The difference of the rigid torque is subtracted if there is a model."""
    t = np.arange(0.0, 60.0, 0.004)
    recording = measured(t, lopsided(t), hidden=arm(nominal=True))
    known = friction_curve(ROBOT, recording, 0, processing=CUTOFF)
    bare = replace(ROBOT, joints=tuple(replace(j, link=None) for j in ROBOT.joints))
    unknown = friction_curve(bare, recording, 0, processing=CUTOFF)
    # the two speeds of a pair differ by up to 30 %, and their mean is used
    error = np.abs(known.friction - friction(known.speed, known.load))
    without = np.abs(unknown.friction - friction(unknown.speed, unknown.load))
    assert np.median(error) < 0.03
    assert np.median(without) > 3 * np.median(error)


@pytest.mark.slow
def test_standard_errors_cover():
    """The scatter of the points over twenty runs matches their standard errors.

    Each pass is matched with more than one pass in the other direction, so samples are used twice.
    """
    motion = constant_speeds(ROBOT, 0, speeds=(0.2, 0.2, 0.2, 0.2), pose=[0.0, 0.4])
    t = np.arange(0.0, motion.duration, 0.008)
    runs = [
        friction_curve(
            ROBOT,
            measured(t, motion.at(t), torque_noise=0.3, seed=k, rate=125.0),
            0,
            processing=CUTOFF,
        )
        for k in range(20)
    ]
    errors = np.concatenate([(r.friction - friction(r.speed, r.load)) / r.std for r in runs])
    assert 0.7 < np.std(errors) < 1.3
    assert 0.9 < np.mean(np.abs(errors) < 2.0) < 0.99


def ramp(t, direction, joint=0):
    q, dq, ddq = (np.zeros((len(t), 2)) for _ in range(3))
    q[:, joint], dq[:, joint] = direction * 0.2 * t, direction * 0.2
    return q, dq, ddq


@pytest.mark.parametrize(
    ("runs", "joint", "message"),
    [
        ([(1.0, 0.0)], 0, "run: joint 1 moves forward only.*record it"),
        ([(-1.0, 0.0)], 0, "run: joint 1 moves backward only.*record it"),
        ([(1.0, 0.0), (-1.0, -0.5)], 0, "passes no position in both directions.*forward and back"),
        ([(1.0, 0.0), (-0.25, 0.8)], 0, "only at different speeds"),
        ([(1.0, 0.0)], 1, "joint 2 never moves"),
    ],
)
def test_motion_without_pairs_is_refused(runs, joint, message):
    """Ramps of joint 1 by their direction and start."""
    t = np.arange(0.0, 8.0, 0.004)
    recordings = []
    for direction, start in runs:
        q, dq, ddq = ramp(t, direction)
        q[:, 0] += start
        recordings.append(measured(t, (q, dq, ddq)))
    with pytest.raises(RecordingError, match=message):
        friction_curve(ROBOT, recordings, joint, processing=CUTOFF)


def test_other_joints_elsewhere():
    """The second joint is at another position in the backward motion."""
    t = np.arange(0.0, 30.0, 0.004)
    q, dq, ddq = lopsided(t)
    q[:, 1] = 0.4 * np.tanh(3 * dq[:, 0])
    dq[:, 1] = np.gradient(q[:, 1], t)
    ddq[:, 1] = np.gradient(dq[:, 1], t)
    with pytest.raises(RecordingError, match="the other joints have moved"):
        friction_curve(ROBOT, measured(t, (q, dq, ddq)), 0, processing=CUTOFF)
