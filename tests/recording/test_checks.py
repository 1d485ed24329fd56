import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from recording.planar_arm import measured

from lieid_casadi import errors
from lieid_casadi.errors import (
    ConstantTorqueWarning,
    DropoutWarning,
    IrregularTimeWarning,
    JointStillWarning,
    LowRateWarning,
    RecordingError,
)
from lieid_casadi.recording import (
    Processing,
    Recording,
    check,
    choose_cutoff,
    detect_period,
    process,
)
from lieid_casadi.recording.sample_timing import INSTANTS_PER_ROW
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


@pytest.fixture(scope="module")
def short():
    return measured(duration=8.0, rate=100.0)


def kinds(warnings):
    return {type(warning) for warning in warnings}


def test_a_gap_of_a_million_seconds_is_two_segments(short):
    t = short.t.copy()
    t[400:] += 1e6
    recording = replace(short, t=t)
    assert kinds(check(recording)) == {DropoutWarning}
    assert choose_cutoff(recording) == choose_cutoff(recording.segments()[0])
    assert detect_period(recording) is None
    parts = process(recording)
    assert [part.t[0] for part in parts] == [t[0], t[400]]
    assert sum(len(part) for part in parts) <= INSTANTS_PER_ROW * len(short)


@pytest.mark.parametrize("step", [1e-6, 1e-12])
def test_clustered_stamps_allocate_no_more_than_their_rows_need(short, step):
    t = short.t.copy()
    t[1::3], t[2::3] = t[::3][: t[1::3].size] + step, t[::3][: t[2::3].size] + 2 * step
    assert np.all(np.diff(t) > 0)
    recording = replace(short, t=t)
    tracemalloc.start()
    try:
        warnings = check(recording)
        parts = process(recording)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert IrregularTimeWarning in kinds(warnings)
    assert sum(len(part) for part in parts) <= INSTANTS_PER_ROW * len(short)
    assert peak < 50e6


@pytest.mark.parametrize("with_dq", [True, False])
@pytest.mark.parametrize("rate", [100.0, 1000.0])
@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_stamps_in_another_unit_are_refused_by_name(unit, factor, rate, with_dq):
    run = measured(duration=4.0, rate=rate)
    recording = replace(run, t=run.t * factor, dq=run.dq if with_dq else None)
    for use in (check, process):
        with pytest.raises(RecordingError, match=rf"column t: .* Hz.*--units {unit}$"):
            use(recording)


def test_milliseconds_at_a_high_rate_show_in_the_velocity():
    run = measured(duration=4.0, rate=4000.0)
    with pytest.raises(RecordingError, match="t in milliseconds: convert with --units ms"):
        check(replace(run, t=run.t * 1e3))


@pytest.mark.parametrize(
    ("units", "time", "angle"),
    [
        ("deg", 1.0, np.pi / 180),
        ("ms", 1e-3, 1.0),
        ("us", 1e-6, 1.0),
        ("ns", 1e-9, 1.0),
        ("deg,ms", 1e-3, np.pi / 180),
        (["ms", "deg"], 1e-3, np.pi / 180),
        ("s,rad", 1.0, 1.0),
    ],
)
def test_units_convert_to_si(short, tmp_path, units, time, angle):
    file = tmp_path / "run.csv"
    given = {"q": short.q / angle, "dq": short.dq / angle, "ddq": short.dq / angle}
    Recording.from_arrays(short.t / time, tau=short.tau, **given).save(file)
    loaded = Recording.load(file, units=units)
    np.testing.assert_allclose(loaded.t, short.t, rtol=1e-12)
    np.testing.assert_allclose(loaded.q, short.q, rtol=1e-12)
    np.testing.assert_allclose(loaded.dq, short.dq, rtol=1e-12)
    np.testing.assert_allclose(loaded.ddq, short.dq, rtol=1e-12)
    np.testing.assert_array_equal(loaded.tau, short.tau)
    assert check(loaded) == check(replace(short, ddq=short.dq))
    part = Recording.load(f"{file}@2:6", units=units)
    np.testing.assert_array_equal(part.q, loaded.cut(2, 6).q)


def test_degrees_leave_joints_that_slide_in_metres(short, tmp_path):
    short.save(tmp_path / "run.npz")
    loaded = Recording.load(tmp_path / "run.npz", units="deg", revolute=[True, False])
    np.testing.assert_allclose(loaded.q[:, 0], np.deg2rad(short.q[:, 0]))
    np.testing.assert_array_equal(loaded.q[:, 1], short.q[:, 1])


@pytest.mark.parametrize(
    ("units", "message"),
    [("grad", "found 'grad', expected some of rad, deg"), ("ms,us", "found both ms and us")],
)
def test_units_that_do_not_exist(short, tmp_path, units, message):
    short.save(tmp_path / "run.npz")
    with pytest.raises(RecordingError, match=message):
        Recording.load(tmp_path / "run.npz", units=units)


@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_a_recording_at_rest_names_the_joints_and_not_the_rate(short, noise):
    random = np.random.default_rng(1)
    still = Recording.from_arrays(
        short.t,
        np.ones_like(short.q) + noise * random.normal(size=short.q.shape),
        noise * random.normal(size=short.q.shape),
        short.tau,
    )
    warnings = check(still)
    assert JointStillWarning in kinds(warnings)
    assert LowRateWarning not in kinds(warnings)
    assert "joints 1, 2 never moved" in str(
        next(w for w in warnings if isinstance(w, JointStillWarning))
    )
    process(still, Processing(cutoff=5.0))


@pytest.mark.parametrize(("joints", "text"), [([0, 1], "joints 1, 2"), ([1], "joint 2")])
def test_torque_that_is_zero_throughout_is_named(short, joints, text):
    tau = short.tau.copy()
    tau[:, joints] = 0.0
    warnings = [w for w in check(replace(short, tau=tau)) if isinstance(w, ConstantTorqueWarning)]
    assert len(warnings) == 1
    assert f"torque of {text} is 0 N·m in every row" in str(warnings[0])
