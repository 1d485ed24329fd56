"""Removal of rows that a recorder repeated because its source had no new message.

A recorder that is faster than its source, or not synchronized with it, writes the last message
again: now and then a row repeats the one before in all signals while the arm moves. The stamps
are those of the recorder; the instants of measurement are up to a period earlier, by an amount
that changes at each repeat. Velocities and accelerations derived across a repeat are wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import RepeatedRowsWarning
from lieid_casadi.recording.arrays import Array, Mask
from lieid_casadi.recording.measurement import OPTIONAL_SIGNALS
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.recording_stream import RecordingStream
from lieid_casadi.recording.sample_timing import sample_period

#: Least steps before and after a repeat that show motion: in quanta, and in RMS steps.
QUANTA, PART_OF_STEP = 3.0, 0.1
#: Runs longer than this multiple of their median, plus one row, are pauses and no repeats.
LONG = 2.0
#: Least number of repeats from which the period of the source is estimated.
ENOUGH = 3
#: Largest spread of the stamps about uniform ones, in periods of the recorder (one, and jitter).
SPREAD = 1.5
#: Rows that are compared at once.
CHUNK = 1 << 18

Rows = Callable[[int, int], Recording]


def without_repeats(
    segment: Recording | RecordingStream,
) -> tuple[Array, Rows, RepeatedRowsWarning | None]:
    """Return stamps (N,), a function that reads rows by number, and a warning if rows were removed.

    Where the remaining rows fit uniform stamps to within the recorder's period, uniform stamps
    replace those of the recorder.
    """
    t, samples = segment.t, [segment] if isinstance(segment, Recording) else segment.samples()
    if not any(repeats(part).any() for part in samples):
        return t, segment.rows, None
    fresh = np.flatnonzero(~_all_repeats(segment))
    removed = len(t) - len(fresh)
    stamps, uniform = _uniform(t[fresh], sample_period(t), removed)

    def rows(first: int, last: int) -> Recording:
        start, end = int(fresh[first]), int(fresh[last - 1]) + 1
        return _chosen(segment.rows(start, end), fresh[first:last] - start, stamps[first:last])

    new = f"; the others are {1e3 * sample_period(stamps):.4g} ms apart" if uniform else ""
    warning = RepeatedRowsWarning(
        f"{segment.title}: {removed} of {len(t)} rows repeat the one before in all "
        f"signals while the arm moves, and were removed{new}: the source was slower than the "
        "recorder"
    )
    return stamps, rows, warning


def repeats(recording: Recording) -> Mask:
    """Mark rows (N,) that repeat the one before in all signals while the arm moves."""
    found = np.zeros(len(recording), dtype=bool)
    others = [x for x in (recording.dq, recording.tau, recording.current) if x is not None]
    if not others:  # a position alone repeats where it is coarse
        return found
    equal = _equal_rows(recording.q)
    for signal in others:
        if not equal.any():
            return found
        equal &= _equal_rows(signal)
    new = np.concatenate([[0], np.flatnonzero(~equal) + 1, [len(recording)]])  # ends of runs
    length = np.diff(new)
    if len(length) < 3:
        return found
    step = np.abs(np.diff(recording.q[new[:-1]], axis=0))
    least = np.maximum(QUANTA * _quantum(step), PART_OF_STEP * np.sqrt(np.mean(step**2, axis=0)))
    moving = np.pad(step > least, ((1, 1), (0, 0)), constant_values=True)
    moves = np.any(moving[:-1] & moving[1:], axis=1)  # into a run and out of it
    for k in np.flatnonzero(moves & (length > 1) & (length <= LONG * np.median(length) + 1)):
        found[new[k] + 1 : new[k + 1]] = True
    return found


def _chosen(part: Recording, rows: NDArray[np.intp], t: Array) -> Recording:
    """Return some rows of a recording, with other stamps."""
    signals: dict[str, Any] = {
        field: None if getattr(part, field) is None else getattr(part, field)[rows]
        for field in ("q", *OPTIONAL_SIGNALS)
    }
    label = part.payload_label
    labels = None if label is None else tuple(label[row] for row in rows)
    return replace(part, t=t, payload_label=labels, **signals)


def _equal_rows(x: Array) -> Mask:
    return np.asarray(np.all(x[1:] == x[:-1], axis=1))


def _quantum(step: Array) -> Array:
    """Return the smallest step (n,) above rounding."""
    smallest = np.where(step > 1e-9 * step.max(axis=0, initial=0.0), step, np.inf).min(axis=0)
    return np.where(np.isfinite(smallest), smallest, 0.0)


def _all_repeats(segment: Recording | RecordingStream) -> Mask:
    """Mark repeats in a whole segment, part by part where it is not in memory."""
    if isinstance(segment, Recording):
        return repeats(segment)
    found = np.zeros(len(segment), dtype=bool)
    margin = 1 << 10
    for first in range(0, len(segment), CHUNK):
        start, last = max(first - margin, 0), min(first + CHUNK, len(segment))
        end = min(last + margin, len(segment))
        found[first:last] = repeats(segment.rows(start, end))[first - start : last - start]
    return found


def _uniform(t: Array, period: float, removed: int) -> tuple[Array, bool]:
    """Return uniform stamps in place of t, if those are near enough, and whether they are."""
    if removed < ENOUGH:
        return t, False
    k = np.arange(len(t), dtype=np.float64)
    # the first row may be any row of its run
    line = np.polynomial.Polynomial.fit(k[1:], t[1:], 1)(k)
    if np.ptp((t - line)[1:]) > SPREAD * period:
        return t, False
    return np.asarray(line), True
