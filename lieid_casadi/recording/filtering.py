"""Zero-phase filters of uniform samples, resampling, and windows that are filtered one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import butter, sosfilt, sosfilt_zi

from lieid_casadi.arrays import Array
from lieid_casadi.recording.sample_timing import uniform_count

#: Cut-offs above this fraction of the rate are too near the Nyquist frequency for a filter.
HIGHEST_CUTOFF = 0.45


def lowpass(x: Array, rate: float, cutoff: float, order: int = 4) -> Array:
    """Return x (K, ...) after a zero-phase Butterworth low-pass; above 0.45 · rate unchanged."""
    if cutoff >= HIGHEST_CUTOFF * rate:
        return np.array(x, dtype=np.float64)
    sections, settled = _sections(order, cutoff, rate)
    # the padding of scipy's default is far shorter than the filter's memory at low cut-offs
    padding = min(x.shape[0] - 1, max(27, round(1.5 * rate / cutoff)))
    # scipy's sosfiltfilt, which computes the settled state again in every call
    ends = 2.0 * x[:1] - x[padding:0:-1], 2.0 * x[-1:] - x[-2 : -padding - 2 : -1]
    rows = np.concatenate([ends[0], x, ends[1]]).reshape(len(x) + 2 * padding, -1).T
    for _ in range(2):  # along the last axis, so that scipy copies once
        rows = sosfilt(sections, rows, zi=settled[:, None] * rows[:, :1])[0][:, ::-1]
    return np.asarray(rows[:, padding : padding + len(x)].T.reshape(x.shape), dtype=np.float64)


@lru_cache(maxsize=64)
def _sections(order: int, cutoff: float, rate: float) -> tuple[Array, Array]:
    """Return the sections of a Butterworth filter and their states in response to a constant 1."""
    sections = np.asarray(butter(order, cutoff, fs=rate, output="sos"))
    return sections, np.asarray(sosfilt_zi(sections))


def central_difference(x: Array, rate: float) -> Array:
    """Return the derivative along axis 0 of uniform samples, of second order at the ends."""
    return np.asarray(np.gradient(x, 1.0 / rate, axis=0, edge_order=2), dtype=np.float64)


SIXTH_ORDER = (45 / 60, -9 / 60, 1 / 60)  # weights of the differences over 2, 4 and 6 samples


def sixth_order_difference(x: Array, rate: float) -> Array:
    """Return the derivative along axis 0 of uniform samples, of sixth order but at the ends."""
    derivative, inner = central_difference(x, rate), len(x) - 6
    if inner > 0:
        derivative[3:-3] = rate * sum(
            weight * (x[3 + k : 3 + k + inner] - x[3 - k : 3 - k + inner])
            for k, weight in enumerate(SIXTH_ORDER, start=1)
        )
    return derivative


def uniform_time(t: Array, rate: float) -> Array:
    """Return uniform instants from the first stamp to the last, nearest to the rate."""
    return np.linspace(t[0], t[-1], uniform_count(t, rate))


def smooth_at(t: Array, x: Array, instants: Array) -> Array:
    """Return values at given instants by monotone cubics: no overshoot, no kinks."""
    return np.asarray(PchipInterpolator(t, x, axis=0)(instants), dtype=np.float64)


def straight_at(t: Array, x: Array, instants: Array) -> Array:
    """Return values at given instants by straight lines, for noisy signals."""
    return np.column_stack([np.interp(instants, t, column) for column in x.T])


def decimate(x: Array, rate: float, step: int) -> Array:
    """Return every step-th sample of x (K, ...) after an anti-aliasing zero-phase low-pass."""
    if step == 1:
        return x
    return lowpass(x, rate, 0.4 * rate / step, order=8)[::step]


#: Relative size of the response beyond the filter's memory.
NEGLIGIBLE = 1e-14
#: Instants per window, at least; with margins of a tenth little is filtered twice.
WINDOW = 8192


@dataclass(frozen=True)
class Window:
    """A stretch of filtered rows and the instants from which they are computed."""

    rows: slice  # of the filtered signal
    instants: slice  # on the grid, margins included
    inside: slice  # positions of the rows among the instants


def filter_memory(rate: float, cutoff: float, order: int = 4) -> int:
    """Return the number of samples after which the response of :func:`lowpass` is below 1e-14."""
    if cutoff >= HIGHEST_CUTOFF * rate:
        return 0
    _, poles, _ = butter(order, cutoff, fs=rate, output="zpk")
    slowest = -np.log(np.abs(poles).max())
    # both ways: poles are double, and the response fades as (1 + k) times a power
    return int(np.ceil((-np.log(NEGLIGIBLE) + 3.0) / slowest))


def windows(count: int, kept: slice, margin: int) -> Iterator[Window]:
    """Yield windows that cover the kept instants of ``count``, with margins for the filter."""
    step = kept.step or 1
    total = len(range(*kept.indices(count)))
    rows = max(1, max(WINDOW, 10 * margin) // step)
    pieces = max(1, -(-total // rows))
    edges = [total * k // pieces for k in range(pieces + 1)]
    for first, last in pairwise(edges):
        start = 0 if first == 0 else max(0, kept.start + first * step - margin)
        end = count if last == total else min(count, kept.start + (last - 1) * step + 1 + margin)
        begin = kept.start + first * step - start
        inside = slice(begin, begin + (last - first - 1) * step + 1, step)
        yield Window(slice(first, last), slice(start, end), inside)
