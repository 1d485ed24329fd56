"""Time stamps that are irregular or in other units, and the conversion of units."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from recording.planar_arm import measured

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


@pytest.fixture(scope="module")
def good():
    return measured(duration=8.0, rate=100.0)


def kinds(warnings):
    return {type(warning) for warning in warnings}


# -- gaps and clusters ----------------------------------------------------------------


def test_a_gap_of_a_million_seconds_is_two_segments(good):
    t = good.t.copy()
    t[400:] += 1e6
    recording = replace(good, t=t)
    assert kinds(check(recording)) == {DropoutWarning}
    assert choose_cutoff(recording) == choose_cutoff(recording.segments()[0])
    assert detect_period(recording) is None
    parts = process(recording)
    assert [part.t[0] for part in parts] == [t[0], t[400]]
    assert sum(len(part) for part in parts) <= INSTANTS_PER_ROW * len(good)


@pytest.mark.parametrize("step", [1e-6, 1e-12])
def test_clustered_stamps_allocate_no_more_than_their_rows_need(good, step):
    t = good.t.copy()
    t[1::3], t[2::3] = t[::3][: t[1::3].size] + step, t[::3][: t[2::3].size] + 2 * step
    assert np.all(np.diff(t) > 0)
    recording = replace(good, t=t)
    tracemalloc.start()
    try:
        warnings = check(recording)
        parts = process(recording)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert IrregularTimeWarning in kinds(warnings)
    assert sum(len(part) for part in parts) <= INSTANTS_PER_ROW * len(good)
    assert peak < 50e6


# -- units of time --------------------------------------------------------------------


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


# -- conversion -----------------------------------------------------------------------


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
def test_units_convert_to_si(good, tmp_path, units, time, angle):
    file = tmp_path / "run.csv"
    given = {"q": good.q / angle, "dq": good.dq / angle, "ddq": good.dq / angle}
    Recording.from_arrays(good.t / time, tau=good.tau, **given).save(file)
    loaded = Recording.load(file, units=units)
    np.testing.assert_allclose(loaded.t, good.t, rtol=1e-12)
    np.testing.assert_allclose(loaded.q, good.q, rtol=1e-12)
    np.testing.assert_allclose(loaded.dq, good.dq, rtol=1e-12)
    np.testing.assert_allclose(loaded.ddq, good.dq, rtol=1e-12)
    np.testing.assert_array_equal(loaded.tau, good.tau)
    assert check(loaded) == check(replace(good, ddq=good.dq))
    part = Recording.load(f"{file}@2:6", units=units)
    np.testing.assert_array_equal(part.q, loaded.cut(2, 6).q)


def test_degrees_leave_joints_that_slide_in_metres(good, tmp_path):
    good.save(tmp_path / "run.npz")
    loaded = Recording.load(tmp_path / "run.npz", units="deg", revolute=[True, False])
    np.testing.assert_allclose(loaded.q[:, 0], np.deg2rad(good.q[:, 0]))
    np.testing.assert_array_equal(loaded.q[:, 1], good.q[:, 1])


@pytest.mark.parametrize(
    ("units", "message"),
    [("grad", "found 'grad', expected some of rad, deg"), ("ms,us", "found both ms and us")],
)
def test_units_that_do_not_exist(good, tmp_path, units, message):
    good.save(tmp_path / "run.npz")
    with pytest.raises(RecordingError, match=message):
        Recording.load(tmp_path / "run.npz", units=units)


# -- rest -----------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_a_recording_at_rest_names_the_joints_and_not_the_rate(good, noise):
    random = np.random.default_rng(1)
    still = Recording.from_arrays(
        good.t,
        np.ones_like(good.q) + noise * random.normal(size=good.q.shape),
        noise * random.normal(size=good.q.shape),
        good.tau,
    )
    warnings = check(still)
    assert JointStillWarning in kinds(warnings)
    assert LowRateWarning not in kinds(warnings)
    assert "joints 1, 2 never moved" in str(
        next(w for w in warnings if isinstance(w, JointStillWarning))
    )
    process(still, Processing(cutoff=5.0))


@pytest.mark.parametrize(("joints", "text"), [([0, 1], "joints 1, 2"), ([1], "joint 2")])
def test_torque_that_is_zero_throughout_is_named(good, joints, text):
    tau = good.tau.copy()
    tau[:, joints] = 0.0
    warnings = [w for w in check(replace(good, tau=tau)) if isinstance(w, ConstantTorqueWarning)]
    assert len(warnings) == 1
    assert f"torque of {text} is 0 N·m in every row" in str(warnings[0])
