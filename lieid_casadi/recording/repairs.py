"""Small damage of recordings that is repaired, and reported with its extent.

On reading, damaged and repeated rows and outliers of single samples are left out, and angles that
jump by a turn are made continuous. Damage beyond these limits is refused or left for the checks.

On processing, rows are left out that a recorder repeated because its source had no new message.
A recorder that is faster than its source, or not synchronized with it, writes the last message
again: now and then a row repeats the one before in all signals while the arm moves. The stamps
are those of the recorder; the instants of measurement are up to a period earlier, by an amount
that changes at each repeat. Velocities and accelerations derived across a repeat are wrong.
Velocities that a drive filtered, or computed by differences, are found where they are late.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from lieid_casadi import errors
from lieid_casadi.arrays import Array, Mask
from lieid_casadi.messages import joints_text
from lieid_casadi.recording import filtering
from lieid_casadi.recording.measurement import (
    FIELDS,
    OPTIONAL_SIGNALS,
    Fault,
    Measurement,
    first_fault,
    in_range,
)
from lieid_casadi.recording.sample_timing import gap_limit, sample_period, sample_rate

Measured = TypeVar("Measured", bound=Measurement)

#: Most rows that may be left out because of a damaged value or outlier, as a part of all rows.
MOST_DAMAGED = 0.01
#: A jump in one sample that differs from a turn by at most this, rad, is a wrapped angle: the
#: motion between two samples.
WRAP_TOLERANCE = 0.5
#: Least ratio of a turn to the 90th percentile of the steps.
RARE_STEP = 5.0
#: Least size of an outlier: over the 99th percentile of how far samples leave both neighbours
#: (white noise reaches 3), over the median step between samples, over the range of the signal
#: without outliers, and over that of the joint with the largest range.
OUTLIER, OUTLIER_STEPS, OUTLIER_RANGE, LARGEST_RANGE = 20.0, 20.0, 0.2, 0.05
#: Part of the RMS speed below which a joint counts as at rest.
SLOW = 0.1
#: Rows from which these are estimated.
ENOUGH_ROWS = 200
#: Least steps before and after a repeat that show motion: in quanta, and in RMS steps.
QUANTA, PART_OF_STEP = 3.0, 0.1
#: Runs longer than this multiple of their median, plus one row, are pauses and no repeats.
LONG = 2.0
#: Least number of repeats from which the period of the source is estimated.
ENOUGH = 3
#: Largest spread of the stamps about uniform ones, in periods of the recorder (one, and jitter).
SPREAD = 1.5
#: Standard errors, by the scatter of so many parts, from which the time by which velocities are
#: late is certain, and least such time in samples: differences of two are late by 0.5.
CERTAIN, PARTS, LEAST_LATE = 3.0, 10, 0.25


def without_damaged_rows(measurement: Measurement) -> tuple[Measurement, Fault | None]:
    """Leave out exact repetitions and a few damaged rows; return the first fault that is left."""
    if first_fault(measurement) is None:
        return measurement, None
    bad = ~in_range(measurement)
    damaged = int(bad.sum())
    if damaged > MOST_DAMAGED * len(measurement):
        return measurement, first_fault(measurement)
    kept = np.flatnonzero(~bad)
    title, found = measurement.title, list(measurement.warnings)
    if damaged:
        first = int(np.argmax(bad))
        found.append(
            errors.DamagedRowsWarning(
                f"{title}: {damaged} of {len(measurement)} rows have values that are missing or "
                f"not finite, the first in row {first + 1}, and were left out",
                samples=damaged,
            )
        )
    repeated = _repetitions(measurement.at(kept))
    if repeated.any():
        count = int(repeated.sum())
        found.append(
            errors.DuplicateRowsWarning(
                f"{title}: {count} of {len(measurement)} rows are exact copies of the row before, "
                "its time included, and were left out",
                samples=count,
            )
        )
        kept = kept[~repeated]
    made = replace(measurement.at(kept), warnings=tuple(found))
    fault = first_fault(made)
    if fault is not None and fault.row is not None:
        fault = replace(fault, row=int(kept[fault.row]))
    return made, fault


def _repetitions(measurement: Measurement) -> Mask:
    """Mark rows (N,) that equal the row before in time and all signals."""
    same = np.zeros(len(measurement), dtype=bool)
    same[1:] = np.diff(measurement.t) == 0.0
    if same.any():
        for field in ("q", *OPTIONAL_SIGNALS):
            values = getattr(measurement, field)
            if values is not None:
                same[1:] &= np.all(values[1:] == values[:-1], axis=1)
    return same


def repaired(measurement: Measured, revolute: Mask | None = None) -> Measured:
    """Return a measurement of sound rows with continuous angles and without outliers."""
    turning = np.ones(measurement.n, bool) if revolute is None else np.asarray(revolute, bool)
    return _without_outliers(_continuous(measurement, turning))


def _steps(measurement: Measurement, x: Array) -> Array:
    """Return the differences (N − 1, n) of a signal, 0 across gaps."""
    inside = np.diff(measurement.t) <= gap_limit(measurement.t)
    return np.diff(x, axis=0) * inside[:, None]


def _continuous(measurement: Measured, turning: Mask) -> Measured:
    """Take the turns out of angles that jump by one between two samples."""
    changed = {}
    joints, samples = np.zeros(measurement.n, dtype=bool), 0
    for field in ("q", "command"):
        x = getattr(measurement, field)
        if x is None:
            continue
        steps = _steps(measurement, x)
        turns = np.rint(steps / (2.0 * np.pi)) * turning
        jumps = (np.abs(turns) == 1.0) & (np.abs(steps - 2.0 * np.pi * turns) < WRAP_TOLERANCE)
        if jumps.any():  # of angles in degrees, many steps are as large
            jumps &= RARE_STEP * np.quantile(np.abs(steps), 0.9, axis=0) < 2.0 * np.pi
        if not jumps.any():
            continue
        changed[field] = x.copy()
        changed[field][1:] -= 2.0 * np.pi * np.cumsum(np.where(jumps, turns, 0.0), axis=0)
        joints |= jumps.any(axis=0)
        samples += int(jumps.sum())
    if not changed:
        return measurement
    warning = errors.WrappedAngleWarning(
        f"{measurement.title}: angles of {joints_text(joints)} jump by a whole turn between two "
        f"samples ({samples} times): they were wrapped, and have been made continuous",
        samples=samples,
        joints=_numbers(joints),
    )
    return replace(measurement, warnings=(*measurement.warnings, warning), **changed)


def _without_outliers(measurement: Measured) -> Measured:
    """Leave out rows where one sample of a signal lies far from both of its neighbours."""
    if len(measurement) < ENOUGH_ROWS:
        return measurement
    found = np.zeros((len(measurement), measurement.n), dtype=bool)
    columns = []
    travel = np.abs(measurement.q[2:] - measurement.q[:-2])
    slow = SLOW * np.sqrt(np.mean(travel**2, axis=0))
    moving = np.pad(travel > slow, ((1, 1), (0, 0)))
    for prefix in ("q", "dq", "tau", "i"):
        x = getattr(measurement, FIELDS[prefix])
        if x is not None:
            outliers = _outliers(x, _steps(measurement, x))
            if prefix in ("tau", "i"):  # at rest friction is anything up to its level
                outliers &= moving
            columns += [f"{prefix}{j + 1}" for j in np.flatnonzero(outliers.any(axis=0))]
            found |= outliers
    rows = np.asarray(found.any(axis=1))
    count = int(rows.sum())
    if not count or count > MOST_DAMAGED * len(rows):
        return measurement
    warning: errors.LieidWarning = errors.OutlierWarning(
        f"{measurement.title}: {count} of {len(rows)} rows have an outlier of a single sample "
        f"({', '.join(columns[:6])}{', …' if len(columns) > 6 else ''}; the first at "
        f"t = {measurement.t[int(np.argmax(rows))]:.6g} s), and were left out",
        samples=count,
        joints=_numbers(np.asarray(found.any(axis=0))),
    )
    made = measurement.at(~rows)
    return replace(made, warnings=(*made.warnings, warning))


def _outliers(x: Array, steps: Array) -> Mask:
    """Mark the samples (N, n) that leave both neighbours, to the same side, by far."""
    leave, back = steps[:-1], -steps[1:]
    away = np.where(leave * back > 0.0, np.minimum(np.abs(leave), np.abs(back)), 0.0)
    usual = np.maximum(
        OUTLIER * np.quantile(away, 0.99, axis=0), OUTLIER_STEPS * np.median(np.abs(steps), axis=0)
    )
    low, high = np.quantile(x, [0.005, 0.995], axis=0)
    reach = high - low
    least = np.maximum(OUTLIER_RANGE * reach, LARGEST_RANGE * reach.max())
    large = np.asarray(away > np.maximum(usual, least))
    for j in np.flatnonzero(large.any(axis=0)):  # of a coarse signal, a few steps are none
        large[:, j] &= away[:, j] > OUTLIER * float(np.min(np.diff(np.unique(x[:, j]))))
    return np.pad(large, ((1, 1), (0, 0)))


def _numbers(joints: Mask) -> tuple[int, ...]:
    return tuple(int(j) + 1 for j in np.flatnonzero(joints))


def without_repeats(segment: Measured) -> tuple[Measured, errors.RepeatedRowsWarning | None]:
    """Return a segment without repeated rows, on uniform stamps where they fit, and a warning."""
    fresh = ~repeats(segment)
    removed = int(np.sum(~fresh))
    if not removed:
        return segment, None
    kept = segment.at(fresh)
    stamps, uniform = _uniform(kept.t, sample_period(segment.t), removed)
    new = f"; the others are {1e3 * sample_period(stamps):.4g} ms apart" if uniform else ""
    warning = errors.RepeatedRowsWarning(
        f"{segment.title}: {removed} of {len(segment)} rows repeat the one before in all "
        f"signals while the arm moves, and were removed{new}: the source was slower than the "
        "recorder"
    )
    return replace(kept, t=stamps), warning


def time_late(missing: Array, rates: Array) -> Array:
    """Return the time, s, by which velocities are late: what they lack per derivative."""
    squares = np.maximum(np.sum(rates**2, axis=0), 1e-300)
    return np.asarray(np.sum(missing * rates, axis=0) / squares)


def late_velocities(segment: Measurement, cutoff: float) -> Array:
    """Return the times (n,), s, by which velocities are certainly later than positions, or 0."""
    if segment.dq is None:
        return np.zeros(segment.n)
    t, rate = segment.t, sample_rate(segment.t)
    times = filtering.uniform_time(t, rate)
    dq = filtering.lowpass(filtering.smooth_at(t, segment.dq, times), rate, cutoff)
    derived = filtering.sixth_order_difference(filtering.smooth_at(t, segment.q, times), rate)
    inner = slice(period := int(rate / cutoff), -period)  # filters that started remain outside
    missing = (filtering.lowpass(derived, rate, cutoff) - dq)[inner]
    ddq = filtering.sixth_order_difference(dq, rate)[inner]
    late = time_late(missing, ddq)
    parts = np.array_split((missing - late * ddq) * ddq, PARTS)
    spread = np.sqrt(sum(part.sum(axis=0) ** 2 for part in parts))
    std = spread / np.maximum(np.sum(ddq**2, axis=0), 1e-300)
    return np.where(late > np.maximum(CERTAIN * std, LEAST_LATE / rate), late, 0.0)


def repeats(recording: Measurement) -> Mask:
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
    above_rounding = step > 1e-9 * step.max(axis=0, initial=0.0)
    quantum = np.where(above_rounding, step, np.inf).min(axis=0)
    quantum = np.where(np.isfinite(quantum), quantum, 0.0)
    least = np.maximum(QUANTA * quantum, PART_OF_STEP * np.sqrt(np.mean(step**2, axis=0)))
    moving = np.pad(step > least, ((1, 1), (0, 0)), constant_values=True)
    moves = np.any(moving[:-1] & moving[1:], axis=1)  # into a run and out of it
    for k in np.flatnonzero(moves & (length > 1) & (length <= LONG * np.median(length) + 1)):
        found[new[k] + 1 : new[k + 1]] = True
    return found


def _equal_rows(x: Array) -> Mask:
    return np.asarray(np.all(x[1:] == x[:-1], axis=1))


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
