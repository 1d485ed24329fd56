"""Periodic motion: its period, and the noise from period to period."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from lieid_casadi.arrays import Array
from lieid_casadi.recording.filtering import lowpass, smooth_at, straight_at, uniform_time
from lieid_casadi.recording.recording import Recording

#: Rate of the samples in which periods are searched, Hz.
SEARCH_RATE = 50.0
#: Half the mean square difference to the motion one period later, over its variance.
REPEATED = 0.01
#: Least value of the same ratio that must be exceeded before the first repetition.
DIFFERENT = 0.25


def detect_period(recording: Recording) -> float | None:
    """Return the period of the motion, s, or None; at least two full periods are needed."""
    if len(recording.segments()) > 1:
        return None
    rate = min(SEARCH_RATE, recording.rate)
    grid = uniform_time(recording.t, rate)
    rate = (grid.size - 1) / (grid[-1] - grid[0])
    q = smooth_at(recording.t, recording.q, grid)
    spread = q.std(axis=0)
    moving = spread > 0.01
    if not moving.any() or grid.size < 16:
        return None
    difference = _difference((q[:, moving] - q[:, moving].mean(axis=0)) / spread[moving])
    lag = _first_return(difference[: grid.size // 2 + 1])
    if lag is None:
        return None
    period = _refined_period(difference, float(lag), 1)
    multiple = int((0.9 * grid.size) // period)
    return float(_refined_period(difference, period, max(1, multiple)) / rate)


def period_noise(recording: Recording, *, cutoff: float | None = None) -> Array | None:
    """Return the standard deviation (n,) of the torque between periods, N·m; None if not periodic.

    With a cut-off, Hz, that of the low-passed torque: a lower bound of the error of any model. None
    for torque of control laws, too: it has the noise of positions alone, which acts by the model's
    accelerations most and, as rounding, is the same in each period.
    """
    if recording.tau is None or recording.drives is not None:
        return None
    period = detect_period(recording)
    if period is None:
        return None
    rate, grid = recording.rate, uniform_time(recording.t, recording.rate)
    tau = straight_at(recording.t, recording.tau, grid)
    edge = 0
    if cutoff is not None:
        tau = lowpass(tau, rate, cutoff)
        edge = min(round(0.5 * rate), (grid.size - round(period * rate)) // 4)
    start, end = grid[edge], grid[-1 - edge]
    first = grid[(grid >= start) & (grid <= end - period)]
    difference = straight_at(grid, tau, first + period) - straight_at(grid, tau, first)
    return np.asarray(np.sqrt(np.mean(difference**2, axis=0) / 2.0))


def _difference(x: Array) -> Array:
    """Return half the mean square difference between x (K, m) and itself, by lag (K,)."""
    count = x.shape[0]
    length = next_fast_len(2 * count, real=True)
    spectrum = rfft(x, length, axis=0)
    products = irfft(np.abs(spectrum) ** 2, length, axis=0)[:count].sum(axis=1)
    squares = np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=1))])
    lags = np.arange(count)
    overlap = squares[count - lags] + squares[count] - squares[lags]
    return np.asarray((overlap / 2.0 - products) / ((count - lags) * x.shape[1]))


def _first_return(difference: Array) -> int | None:
    away = np.nonzero(difference > DIFFERENT)[0]
    if not away.size:
        return None
    after = np.arange(1, difference.size - 1)
    here = difference[after]
    lowest = (here <= difference[after - 1]) & (here <= difference[after + 1])
    found = after[lowest & (after > away[0]) & (here < REPEATED)]
    return int(found[0]) if found.size else None


def _refined_period(difference: Array, period: float, multiple: int) -> float:
    """Return the period in samples, by a parabola through the lowest point near a multiple."""
    centre = round(period * multiple)
    reach = max(2, multiple)
    low, high = max(1, centre - reach), min(difference.size - 2, centre + reach)
    if low >= high:
        return period
    k = low + int(np.argmin(difference[low : high + 1]))
    before, here, after = difference[k - 1], difference[k], difference[k + 1]
    curvature = before - 2.0 * here + after
    shift = 0.5 * (before - after) / curvature if curvature > 0.0 else 0.0
    return float((k + np.clip(shift, -0.5, 0.5)) / multiple)
