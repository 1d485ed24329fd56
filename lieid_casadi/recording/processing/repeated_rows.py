"""Rows that a recorder wrote again because its source had nothing new: left out, and told.

A recorder that runs faster than the joint's source, or beside it, holds the last message: every
so often a row repeats the one before in all signals, while the arm moves on. Its stamps are
those of the recorder; the source's own are up to a period earlier, by an amount that jumps at
each repeat. Velocity and acceleration that are derived across it are wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import RepeatedRowsWarning
from lieid_casadi.recording.arrays import Array, Mask
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.recording_stream import RecordingStream
from lieid_casadi.recording.sample_timing import sample_period

#: Steps before and after a repeat that tell motion from rest: in quanta, and in RMS steps.
QUANTA, PART_OF_STEP = 3.0, 0.1
#: Runs beyond this many times their median, and one row, are a pause: of the arm or of the source.
LONG = 2.0
#: Repeats that make a source of its own period of it.
ENOUGH = 3
#: Spread of the stamps about uniform ones, in periods of the recorder: a period and its jitter.
SPREAD = 1.5
#: Rows that are looked at together.
CHUNK = 1 << 18

Rows = Callable[[int, int], Recording]


def without_repeats(
    segment: Recording | RecordingStream,
) -> tuple[Array, Rows, RepeatedRowsWarning | None]:
    """Return stamps (N,), how to read rows by their number, and what there is to tell.

    Where the rows that are left fit uniform stamps to within the recorder's period, those take
    the place of the recorder's.
    """
    t, looked = segment.t, [segment] if isinstance(segment, Recording) else segment.samples()
    if not any(repeats(part).any() for part in looked):
        return t, segment.rows, None
    fresh = np.flatnonzero(~_all_repeats(segment))
    left = len(t) - len(fresh)
    stamps, uniform = _uniform(t[fresh], sample_period(t), left)

    def rows(first: int, last: int) -> Recording:
        start, end = int(fresh[first]), int(fresh[last - 1]) + 1
        return _chosen(segment.rows(start, end), fresh[first:last] - start, stamps[first:last])

    new = f"; the others are {1e3 * sample_period(stamps):.4g} ms apart" if uniform else ""
    told = RepeatedRowsWarning(
        f"{segment.title}: {left} of {len(t)} rows repeat the one before in all "
        f"signals while the arm moves, and were left out{new}: the source was slower than the "
        "recorder"
    )
    return stamps, rows, told


def repeats(recording: Recording) -> Mask:
    """Mark rows (N,) that repeat the one before, all signals alike, while the arm moves."""
    found = np.zeros(len(recording), dtype=bool)
    others = [x for x in (recording.dq, recording.tau, recording.current) if x is not None]
    if not others:  # a position alone repeats where it is coarse
        return found
    alike = _alike(recording.q)
    for signal in others:
        if not alike.any():
            return found
        alike &= _alike(signal)
    new = np.concatenate([[0], np.flatnonzero(~alike) + 1, [len(recording)]])  # ends of runs
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
        for field in ("q", "dq", "tau", "ddq", "temperature", "current")
    }
    label = part.payload_label
    labels = None if label is None else tuple(label[row] for row in rows)
    return replace(part, t=t, payload_label=labels, **signals)


def _alike(x: Array) -> Mask:
    return np.asarray(np.all(x[1:] == x[:-1], axis=1))


def _quantum(step: Array) -> Array:
    """Smallest step (n,) above rounding."""
    seen = np.where(step > 1e-9 * step.max(axis=0, initial=0.0), step, np.inf).min(axis=0)
    return np.where(np.isfinite(seen), seen, 0.0)


def _all_repeats(segment: Recording | RecordingStream) -> Mask:
    """The same of a whole segment, part by part where it is not in memory."""
    if isinstance(segment, Recording):
        return repeats(segment)
    found = np.zeros(len(segment), dtype=bool)
    margin = 1 << 10
    for first in range(0, len(segment), CHUNK):
        start, last = max(first - margin, 0), min(first + CHUNK, len(segment))
        end = min(last + margin, len(segment))
        found[first:last] = repeats(segment.rows(start, end))[first - start : last - start]
    return found


def _uniform(t: Array, period: float, left_out: int) -> tuple[Array, bool]:
    """Return uniform stamps through those that are left, if they are near enough."""
    if left_out < ENOUGH:
        return t, False
    k = np.arange(len(t), dtype=np.float64)
    # the first row may be any of its run
    line = np.polynomial.Polynomial.fit(k[1:], t[1:], 1)(k)
    if np.ptp((t - line)[1:]) > SPREAD * period:
        return t, False
    return np.asarray(line), True
