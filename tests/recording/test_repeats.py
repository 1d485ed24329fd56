"""Rows that a recorder wrote again because its source had nothing new."""

import numpy as np
import pytest
from real_arms import PANDA, needs
from recording.planar_arm import motion, rigid_torque

from lieid_casadi.errors import RepeatedRowsWarning
from lieid_casadi.recording import Processing, Recording, process
from lieid_casadi.recording.repairs import repeats

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


def test_derived_velocity_is_smooth_across_repeats():
    recording, _ = held(dq=False)
    (segment,) = process(recording, Processing(cutoff=3.0))
    assert np.all(errors(segment, 0.5 / 30)[0] < 0.02)
    (as_written,) = process(Recording.from_arrays(recording.t, recording.q), Processing(cutoff=3.0))
    assert np.all(errors(as_written, 0.5 / 30)[0] > 0.04)  # a position alone is not judged


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


def test_an_irregular_source_keeps_its_stamps():
    random = np.random.default_rng(1)
    recording, _ = held()
    keep = np.sort(random.choice(len(recording), 3 * len(recording) // 4, replace=False))
    wandering = recording.t[keep] + 0.2 * np.sin(0.5 * recording.t[keep])
    part = Recording.from_arrays(
        wandering, recording.q[keep], recording.dq[keep], recording.tau[keep]
    )
    (segment,) = process(part, Processing(cutoff=3.0))
    (warning,) = segment.warnings
    assert "ms apart" not in str(warning)
    np.testing.assert_array_equal(segment.t[[0, -1]], wandering[[0, -1]])


@pytest.mark.real
@needs(PANDA / "excitation.csv.gz")
def test_the_panda_was_recorded_faster_than_its_source():
    recording = Recording.load(PANDA / "excitation.csv.gz")
    (segment,) = process(recording, Processing(cutoff=3.0))
    assert repeats(recording).sum() == 14
    assert "34.02 ms apart" in str(segment.warnings[0])
