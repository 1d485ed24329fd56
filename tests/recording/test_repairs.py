"""Small damage of files is repaired and counted; sound recordings stay as they are."""

from dataclasses import replace

import numpy as np
import pytest
from recording.planar_arm import measured, motion, rigid_torque
from scipy.signal import lfilter

from lieid_casadi.errors import (
    DamagedRowsWarning,
    DuplicateRowsWarning,
    LateVelocityWarning,
    OutlierWarning,
    RecordingError,
    RepairWarning,
    RepeatedRowsWarning,
    WrappedAngleWarning,
)
from lieid_casadi.recording import Processing, Recording, process
from lieid_casadi.recording.repairs import late_velocities, repeats


@pytest.fixture
def run():
    return measured(duration=8.0, rate=100.0)


def saved(run, tmp_path, change=lambda lines: lines, name="run.csv"):
    file = tmp_path / name
    run.save(file)
    lines = file.read_text().splitlines()
    file.write_text("\n".join(change(lines)) + "\n")
    return file


def replaced(line, text, column=2):
    cells = line.split(",")
    cells[column] = text
    return ",".join(cells)


@pytest.mark.parametrize("text", ["nan", "", " ", "inf", "1e300"])
def test_a_row_with_a_missing_value_is_left_out(run, tmp_path, text):
    file = saved(run, tmp_path, lambda x: [*x[:51], replaced(x[51], text), *x[52:]])
    read = Recording.load(file)
    assert len(read) == len(run) - 1
    np.testing.assert_array_equal(read.tau, np.delete(run.tau, 50, axis=0))
    (warning,) = read.warnings
    assert isinstance(warning, DamagedRowsWarning)
    assert warning.samples == 1
    assert "1 of 800 rows" in str(warning)
    assert "row 51" in str(warning)


def test_a_file_that_ends_within_a_row(run, tmp_path):
    file = saved(run, tmp_path, lambda x: [*x[:-1], x[-1][:9]])
    read = Recording.load(file)
    np.testing.assert_array_equal(read.q, run.q[:-1])
    assert read.warnings[0].samples == 1


def test_much_damage_is_refused_with_its_place(run, tmp_path):
    file = saved(run, tmp_path, lambda x: [*x[:51], *(replaced(y, "") for y in x[51:71]), *x[71:]])
    with pytest.raises(RecordingError, match="line 52, column q2: found an empty cell"):
        Recording.load(file)


def test_other_faults_are_refused_with_the_line_of_the_file(run, tmp_path):
    """Rows that were left out before them count."""
    lines = [*range(1, 51), 51, *range(52, 90), 88, *range(90, 801)]
    file = saved(
        run,
        tmp_path,
        lambda x: [x[0]] + [replaced(x[k], "nan") if k == 51 else x[k] for k in lines],
    )
    with pytest.raises(RecordingError, match=r"line 91, column t: .*time goes back"):
        Recording.load(file)


@pytest.mark.parametrize("suffix", ["csv", "npz", "parquet"])
def test_exact_copies_of_rows_are_left_out(run, tmp_path, suffix):
    twice = np.sort(np.append(np.arange(len(run)), [7, 300, 301]))
    file = tmp_path / f"run.{suffix}"
    run.at(twice).save(file)
    read = Recording.load(file)
    np.testing.assert_array_equal(read.t, run.t)
    np.testing.assert_array_equal(read.tau, run.tau)
    (warning,) = read.warnings
    assert isinstance(warning, DuplicateRowsWarning)
    assert warning.samples == 3


def test_wrapped_angles_are_made_continuous(tmp_path):
    t = np.arange(0.0, 20.0, 0.01)
    q = np.column_stack([2.5 + 2.0 * np.sin(t), 0.5 * t, np.sin(t)])
    np.savez(tmp_path / "run.npz", t=t, q=(q + np.pi) % (2.0 * np.pi) - np.pi)
    read = Recording.load(tmp_path / "run.npz")
    np.testing.assert_allclose(read.q - read.q[0], q - q[0], atol=1e-12)
    (warning,) = read.warnings
    assert isinstance(warning, WrappedAngleWarning)
    assert warning.joints == (1, 2)
    # one crossing upwards of each odd multiple of π, and as many downwards where the joint returns
    crossings = np.sum(np.diff(np.floor((q + np.pi) / (2.0 * np.pi)), axis=0) != 0)
    assert warning.samples == crossings
    slides = Recording.load(tmp_path / "run.npz", revolute=[True, False, True])
    assert slides.warnings[0].joints == (1,)


@pytest.mark.parametrize(
    ("field", "size"), [("q", 0.7), ("dq", -3.0), ("tau", 200.0), ("tau", None)]
)
def test_outliers_of_single_samples_are_left_out(run, tmp_path, field, size):
    arrays = {name: getattr(run, name).copy() for name in ("q", "dq", "tau")}
    rows = [200, 555]
    for row in rows:  # without a size: a reading of zero, as after a lost message
        values = arrays[field]
        values[row, 0] = 0.0 if size is None else values[row, 0] + size
    np.savez(tmp_path / "run.npz", t=run.t, **arrays)
    read = Recording.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(read.t, np.delete(run.t, rows))
    np.testing.assert_array_equal(getattr(read, field), np.delete(getattr(run, field), rows, 0))
    (warning,) = read.warnings
    assert isinstance(warning, OutlierWarning)
    assert (warning.samples, warning.joints) == (2, (1,))


def test_torque_that_jumps_at_an_instant_of_rest_is_no_outlier(tmp_path):
    """Friction is undetermined where a joint stands still, if only for one sample."""
    t = np.arange(0.0, 10.0, 0.01)
    q = np.sin(0.5 * np.pi * t)[:, None]  # reverses at t = 5 s, at a sample
    tau = 3.0 * q - 5.0
    tau[500] += 10.0
    np.savez(tmp_path / "run.npz", t=t, q=q, tau=tau)
    assert not Recording.load(tmp_path / "run.npz").warnings
    tau[[500, 600]] = tau[[600, 500]]  # in motion it is one
    np.savez(tmp_path / "run.npz", t=t, q=q, tau=tau)
    assert Recording.load(tmp_path / "run.npz").warnings[0].samples == 1


@pytest.mark.parametrize("seed", range(5))
def test_sound_signals_are_not_touched(tmp_path, seed):
    """Noise with heavy tails, coarse encoders, steps of friction, joints at rest."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 30.0, 0.005)
    q = np.column_stack([np.sin(t), 0.02 * np.sin(3.0 * t), np.full_like(t, 0.3)])
    dq = np.gradient(q, t, axis=0) + 0.01 * rng.standard_t(3, q.shape)
    tau = 5.0 * np.sign(dq) + 2.0 * q + 0.2 * rng.laplace(size=q.shape)
    q = np.round(q / 1e-3) * 1e-3
    q[:, 2] += 1e-3 * (rng.uniform(size=len(t)) < 0.01)
    np.savez(tmp_path / "run.npz", t=t, q=q, dq=dq, tau=tau)
    read = Recording.load(tmp_path / "run.npz")
    assert not [w for w in read.warnings if isinstance(w, RepairWarning)]
    np.testing.assert_array_equal(read.tau, tau)


# -- Rows that a recorder wrote again because its source had nothing new --


SOURCE = 0.034


def held(*, source=SOURCE, recorder=1 / 30, duration=24.0, noise=1e-3, dq=True, seed=0):
    """Rows of a recorder that writes the last message of a source."""
    random = np.random.default_rng(seed)
    sampled = np.arange(0.0, duration + 1.0, source)
    q, velocity, ddq = motion(sampled)
    tau = rigid_torque(q, velocity, ddq)
    tau += 0.1 * random.normal(size=q.shape)
    velocity = velocity + noise * random.normal(size=q.shape)
    t = np.arange(0.05, duration, recorder) + 1e-4 * random.uniform(
        size=len(np.arange(0.05, duration, recorder))
    )
    last = np.searchsorted(sampled, t) - 1
    return Recording.from_arrays(t, q[last], velocity[last] if dq else None, tau[last]), last


def errors(segment, lag):
    """RMS error of dq and ddq against the motion at stamps that are late."""
    _, dq, ddq = motion(segment.t - lag)
    inner = slice(30, -30)
    return (segment.dq - dq)[inner].std(axis=0), (segment.filter(segment.ddq - ddq)).std(axis=0)


@pytest.mark.parametrize(("source", "recorder"), [(SOURCE, 1 / 30), (0.02, 0.002), (0.01, 0.008)])
def test_repeats_are_removed_and_stamps_are_those_of_the_source(source, recorder):
    recording, last = held(source=source, recorder=recorder)
    expected = np.concatenate([[False], np.diff(last) == 0])
    found = repeats(recording)
    np.testing.assert_array_equal(found, expected)
    (segment,) = process(recording, Processing(cutoff=3.0))
    (warning,) = segment.warnings
    assert isinstance(warning, RepeatedRowsWarning)
    assert f"{found.sum()} of {len(recording)} rows" in str(warning)
    assert f"{1e3 * source:.4g} ms" in str(warning)
    late = 0.5 * recorder
    assert np.all(errors(segment, late)[0] < 0.01)
    assert np.all(errors(segment, late)[1] < 0.04)


def test_rest_and_coarse_signals_are_no_repeats():
    t = np.arange(0.0, 10.0, 0.01)
    q, dq, _ = motion(t)
    q[300:500], dq[300:500] = q[300], 0.0
    still = Recording.from_arrays(t, q, dq, np.round(q, 2))
    assert not repeats(still).any()
    coarse = Recording.from_arrays(t, np.round(q, 2), np.round(dq, 1), np.round(q, 1))
    assert not repeats(coarse).any()
    (segment,) = process(still, Processing(cutoff=3.0))
    assert not segment.warnings


# -- Velocities that are late --


def run_with(velocity, *, rate=100.0, counts=2.0**16, seed=0):
    """Return a run of two joints whose recorded velocity is a function of the true one at 2 kHz."""
    random, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.0005)
    phase = 2.0 * np.pi * np.outer(t, [0.31, 0.47]) + random.uniform(0.0, 6.0, 2)
    q = np.sin(phase) + 0.2 * np.sin(3.0 * phase)
    dq = np.gradient(q, t, axis=0)
    step, quantum = round(2000.0 / rate), 2.0 * np.pi / counts
    measured = velocity(dq) + 1e-3 * random.normal(size=dq.shape)
    rounded = np.round(q / quantum) * quantum
    return Recording.from_arrays(t[::step], rounded[::step], measured[::step]), dq[::step]


def filtered(seconds):
    keep = np.exp(-0.0005 / seconds)
    return lambda dq: lfilter([1 - keep], [1, -keep], dq, axis=0, zi=keep * dq[:1])[0]


@pytest.mark.parametrize("counts", [2.0**12, 2.0**16])
@pytest.mark.parametrize("seconds", [0.01, 0.02])
def test_the_time_by_which_a_filtered_velocity_is_late(seconds, counts):
    recording, _ = run_with(filtered(seconds), counts=counts)
    np.testing.assert_allclose(late_velocities(recording, 5.0), seconds, rtol=0.1)


@pytest.mark.parametrize("seed", range(4))
def test_a_filter_that_starts_at_rest_is_late_too(seed):
    """Low-pass filters carry its first error into the recording."""
    keep = np.exp(-0.0005 / 0.01)
    recording, _ = run_with(lambda dq: lfilter([1 - keep], [1, -keep], dq, axis=0), seed=seed)
    np.testing.assert_allclose(late_velocities(recording, 1.5), 0.01, rtol=0.1)


def test_a_late_velocity_is_derived_from_the_positions():
    recording, dq = run_with(filtered(0.02))
    (segment,) = process(recording, Processing(cutoff=5.0))
    (warning,) = segment.warnings
    assert isinstance(warning, LateVelocityWarning)
    assert "joints 1, 2" in str(warning)
    assert np.std(segment.dq - dq[: len(segment)], axis=0).max() < 0.005  # recorded: 0.11, 0.25


def test_differences_to_the_sample_before_are_late_by_half_a_sample():
    recording, dq = run_with(lambda dq: dq)
    late = np.diff(recording.q[[0, *range(len(recording))]], axis=0) * 100.0
    late[0] = late[1]
    (segment,) = process(replace(recording, dq=late), Processing(cutoff=5.0))
    assert not segment.warnings
    np.testing.assert_allclose(late_velocities(replace(recording, dq=late), 5.0), 0.005, rtol=0.05)
    assert np.std(segment.dq - dq[: len(segment)], axis=0).max() < 0.01  # recorded: 0.03, 0.06


@pytest.mark.parametrize("counts", [2.0**12, 2.0**14, 2.0**18])
@pytest.mark.parametrize("seed", range(4))
def test_a_velocity_in_time_is_kept(seed, counts):
    recording, _ = run_with(lambda dq: dq, counts=counts, seed=seed)
    assert not late_velocities(recording, 5.0).any()
