"""Sample period, lost samples, gaps between segments, and the time unit that a rate suggests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RecordingError

#: A pause is a gap when it is both this many sample periods long ...
GAP_PERIODS = 5.0
#: ... and this many seconds: shorter pauses hide no motion of an arm and are interpolated.
GAP_SECONDS = 0.05
#: Mean rates, Hz, that recordings of arms have; others come from stamps in another unit.
LOWEST_RATE, HIGHEST_RATE = 1.0, 1e6
#: Rates of recorders, Hz: a unit is suggested if the stamps have such a rate in it.
USUAL_RATES = (5.0, 5e4)
#: Unit of time -> seconds.
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
TIME_NAMES = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
#: Uniform instants per row, at most: stamps in clusters would ask for an unbounded number.
INSTANTS_PER_ROW = 4


def sample_period(t: Array) -> float:
    """Return the median time between samples, s (t: (N,), N ≥ 2)."""
    return float(np.median(np.diff(t)))


def gap_limit(t: Array) -> float:
    """Return the step in time, s, beyond which two samples belong to different segments."""
    return max(GAP_PERIODS * sample_period(t), GAP_SECONDS)


def segment_edges(t: Array, labels: Sequence[str] | None = None) -> list[int]:
    """Return the first row of each segment and, last, the number of rows."""
    breaks = np.diff(t) > gap_limit(t)
    if labels is not None:
        payload = np.asarray(labels)
        breaks |= payload[1:] != payload[:-1]
    return [0, *(np.nonzero(breaks)[0] + 1).tolist(), t.size]


def dropout_limit(t: Array) -> float:
    """Return the step in time, s, beyond the spread of the stamps: samples were lost in it."""
    steps = np.diff(t)
    return float(max(1.75 * np.median(steps), 1.45 * np.percentile(steps, 90.0)))


def mean_rate(t: Array) -> float:
    """Return the mean rate within segments, Hz (t: (N,), N ≥ 2); gaps do not count."""
    steps = np.diff(t)
    inside = steps[steps <= gap_limit(t)]
    return float(inside.size / inside.sum())


def sample_rate(t: Array) -> float:
    """Return the rate, Hz, of uniform instants: of the median step, at most four times the mean."""
    return min(1.0 / sample_period(t), INSTANTS_PER_ROW * mean_rate(t))


def uniform_count(t: Array, rate: float) -> int:
    """Return the number of uniform instants, at least 2 and at most four for each row."""
    wanted = float(t[-1] - t[0]) * rate
    return max(2, min(round(min(wanted, 1e15)) + 1, INSTANTS_PER_ROW * t.size))


def is_plausible_rate(rate: float) -> bool:
    """Return whether stamps with a mean rate, Hz, may be in seconds."""
    return LOWEST_RATE * (1.0 + 1e-6) < rate <= HIGHEST_RATE


def unit_of_rate(rate: float) -> str | None:
    """Return the unit, other than s, in which stamps with a mean rate are those of a recorder."""
    low, high = USUAL_RATES
    units = [
        unit for unit, size in TIME_UNITS.items() if unit != "s" and low <= rate / size <= high
    ]
    return units[0] if units else None


def require_plausible_rate(t: Array, title: str) -> None:
    """Refuse stamps (N,) whose mean rate shows that they are not in seconds."""
    rate = mean_rate(t) if t.size > 1 else np.inf
    if t.size < 2 or is_plausible_rate(rate):
        return
    unit = unit_of_rate(rate)
    remark = (
        f": the stamps look like {TIME_NAMES[unit]}; if they are, convert with --units {unit}"
        if unit
        else ": check the unit of the stamps"
    )
    raise RecordingError(
        f"{title}: column t: found a mean rate of {rate:.3g} Hz, expected stamps in seconds "
        f"(rates between 1 Hz and 1 MHz){remark}"
    )
