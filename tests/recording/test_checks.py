from dataclasses import replace

import numpy as np
import pytest
from recording.planar_arm import measured

from lieid_casadi import errors
from lieid_casadi.errors import RecordingError
from lieid_casadi.recording import Recording, check
from lieid_casadi.robot import Joint, Limits, Robot

DEGREES = 180 / np.pi


def robot(lower=-3.0, upper=3.0, torque=np.nan, joints=2, revolute=True):
    screw = np.array([0, -1, 0, 0, 0, 0.0] if revolute else [0, 0, 0, 0, 0, 1.0])
    limits = Limits(position_lower=lower, position_upper=upper, torque=torque)
    made = tuple(Joint(f"joint_{j}", screw, np.eye(4), limits) for j in range(joints))
    return Robot("planar", made)


def names(warnings):
    return [type(warning).__name__ for warning in warnings]


def only(warnings, kind):
    (warning,) = warnings
    assert isinstance(warning, kind)
    return str(warning)


@pytest.fixture(scope="module")
def good():
    return measured()


@pytest.mark.parametrize("jitter", [0.0, 0.9])
@pytest.mark.parametrize("rate", [50, 200, 1000])
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_sound_recording_has_no_warnings(jitter, rate, noise):
    recording = measured(rate=rate, jitter=jitter, noise=noise)
    assert check(recording) == ()
    assert check(recording, robot(torque=100.0)) == ()
    assert check(recording, robot()) == ()


# -- certainly wrong ------------------------------------------------------------------


def test_another_number_of_joints(good):
    with pytest.raises(RecordingError, match=r"found 2 joints \(q1…q2\), expected 7"):
        check(good, robot(joints=7))


@pytest.mark.parametrize("limited", [True, False])
def test_degrees_are_refused(good, limited):
    arm = robot() if limited else None
    with pytest.raises(RecordingError, match=r"column q1.*radians.*--units deg"):
        check(replace(good, q=good.q * DEGREES, dq=good.dq * DEGREES), arm)


def test_degrees_per_second_beside_radians(good):
    with pytest.raises(RecordingError, match=r"column dq1: found 57\.3 times the derivative"):
        check(replace(good, dq=good.dq * DEGREES))
    with pytest.raises(RecordingError, match=r"column dq1: found 0\.0175 times the derivative"):
        check(replace(good, q=good.q * DEGREES * 0.1, dq=good.dq * 0.1))


# -- suspicious -----------------------------------------------------------------------


def test_beyond_the_limits(good):
    text = only(check(good, robot(lower=-0.9, upper=3.0)), errors.JointLimitWarning)
    assert "joint 1 " in text


def test_lost_samples_and_gaps(good):
    keep = np.ones(len(good), dtype=bool)
    keep[[500, 900]] = False
    fields = {f: getattr(good, f)[keep] for f in ("t", "q", "dq", "tau")}
    text = only(check(replace(good, **fields)), errors.DropoutWarning)
    assert "2 dropouts" in text
    assert "interpolated" in text
    keep[2000:2100] = False
    fields = {f: getattr(good, f)[keep] for f in ("t", "q", "dq", "tau")}
    text = only(check(replace(good, **fields)), errors.DropoutWarning)
    assert "3 dropouts, the longest 0.505 s" in text
    assert "split into 2 segments" in text


def test_a_rate_too_low_for_the_motion(good):
    every = slice(None, None, 80)  # 2.5 Hz for harmonics up to 0.6 Hz
    fields = {f: getattr(good, f)[every] for f in ("t", "q", "dq", "tau")}
    assert "LowRateWarning" in names(check(replace(good, **fields)))
    every = slice(None, None, 10)
    fields = {f: getattr(good, f)[every] for f in ("t", "q", "dq", "tau")}
    assert check(replace(good, **fields)) == ()


def test_clipped_torque(good):
    limit = 0.8 * np.abs(good.tau).max(axis=0)
    text = only(
        check(replace(good, tau=np.clip(good.tau, -limit, limit))), errors.TorqueClippedWarning
    )
    assert "joints 1, 2" in text
    one = np.clip(good.tau, -np.inf, [np.inf, limit[1]])
    assert "joint 2 stays" in only(check(replace(good, tau=one)), errors.TorqueClippedWarning)


def test_torque_at_the_robots_limit(good):
    text = only(
        check(replace(good, tau=np.clip(good.tau, -30, 30)), robot(torque=30.0)),
        errors.TorqueClippedWarning,
    )
    assert text.endswith("joint 1 reaches the robot's torque limit")


def test_holding_still_at_the_largest_torque_is_not_clipping():
    t = np.arange(0, 20, 0.005)
    ramp = np.clip(t - 5, 0, 5)
    q = np.column_stack([1.5 - 0.3 * ramp, 0.1 * ramp])
    tau = np.column_stack([40 * np.cos(q[:, 0]), np.cos(q[:, 1])])
    found = check(Recording.from_arrays(t, q, tau=tau))
    assert "TorqueClippedWarning" not in names(found)
