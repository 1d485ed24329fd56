"""Removal of rows that a recorder repeated because its source had no new message.

A recorder that is faster than its source, or not synchronized with it, writes the last message
again: now and then a row repeats the one before in all signals while the arm moves. The stamps
are those of the recorder; the instants of measurement are up to a period earlier, by an amount
that changes at each repeat. Velocities and accelerations derived across a repeat are wrong.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.errors import RepeatedRowsWarning
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.sample_timing import sample_period

#: Least steps before and after a repeat that show motion: in quanta, and in RMS steps.
QUANTA, PART_OF_STEP = 3.0, 0.1
#: Runs longer than this multiple of their median, plus one row, are pauses and no repeats.
LONG = 2.0
#: Least number of repeats from which the period of the source is estimated.
ENOUGH = 3
#: Largest spread of the stamps about uniform ones, in periods of the recorder (one, and jitter).
SPREAD = 1.5


def without_repeats(segment: Recording) -> tuple[Recording, RepeatedRowsWarning | None]:
    """Return a segment without repeated rows, and a warning if there were any.

    Where the remaining rows fit uniform stamps to within the recorder's period, uniform stamps
    replace those of the recorder.
    """
    fresh = ~repeats(segment)
    removed = int(np.sum(~fresh))
    if not removed:
        return segment, None
    kept = segment.at(fresh)
    stamps, uniform = _uniform(kept.t, sample_period(segment.t), removed)
    new = f"; the others are {1e3 * sample_period(stamps):.4g} ms apart" if uniform else ""
    warning = RepeatedRowsWarning(
        f"{segment.title}: {removed} of {len(segment)} rows repeat the one before in all "
        f"signals while the arm moves, and were removed{new}: the source was slower than the "
        "recorder"
    )
    return replace(kept, t=stamps), warning


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


def _equal_rows(x: Array) -> Mask:
    return np.asarray(np.all(x[1:] == x[:-1], axis=1))


def _quantum(step: Array) -> Array:
    """Return the smallest step (n,) above rounding."""
    smallest = np.where(step > 1e-9 * step.max(axis=0, initial=0.0), step, np.inf).min(axis=0)
    return np.where(np.isfinite(smallest), smallest, 0.0)


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
