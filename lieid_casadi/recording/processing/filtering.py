"""Zero-phase low-pass, differences and resampling of uniform samples."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import butter, sosfilt, sosfilt_zi

from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.sample_timing import uniform_count

#: Cut-offs above this fraction of the rate are too near the Nyquist frequency for a filter.
HIGHEST_CUTOFF = 0.45


def lowpass(x: Array, rate: float, cutoff: float, order: int = 4) -> Array:
    """Return x after a zero-phase Butterworth low-pass along axis 0 (forward and backward).

    Parameters
    ----------
    x
        (K, ...) uniform samples.
    rate, cutoff
        Hz; a cut-off at or above 0.45 · rate passes x unchanged.
    order
        Of the one-way filter; both ways together have twice the slope.
    """
    if cutoff >= HIGHEST_CUTOFF * rate:
        return np.array(x, dtype=np.float64)
    sections, settled = _sections(order, cutoff, rate)
    # the padding of scipy's default is far shorter than the filter's memory at low cut-offs
    padding = min(x.shape[0] - 1, max(27, round(1.5 * rate / cutoff)))
    # scipy's sosfiltfilt, which computes the settled state again in every call
    ends = 2.0 * x[:1] - x[padding:0:-1], 2.0 * x[-1:] - x[-2 : -padding - 2 : -1]
    values = np.concatenate([ends[0], x, ends[1]])
    settled = settled.reshape(*settled.shape, *[1] * (x.ndim - 1))
    for _ in range(2):
        values = sosfilt(sections, values, axis=0, zi=settled * values[:1])[0][::-1]
    return np.array(values[padding : len(values) - padding], dtype=np.float64)


@lru_cache(maxsize=64)
def _sections(order: int, cutoff: float, rate: float) -> tuple[Array, Array]:
    """Return the sections of a Butterworth filter and their states in response to a constant 1."""
    sections = np.asarray(butter(order, cutoff, fs=rate, output="sos"))
    return sections, np.asarray(sosfilt_zi(sections))


def central_difference(x: Array, rate: float) -> Array:
    """Return the derivative along axis 0 of uniform samples, of second order at the ends."""
    return np.asarray(np.gradient(x, 1.0 / rate, axis=0, edge_order=2), dtype=np.float64)


def uniform_time(t: Array, rate: float) -> Array:
    """Return uniform instants from the first stamp to the last, nearest to the rate."""
    return np.linspace(t[0], t[-1], uniform_count(t, rate))


def smooth_at(t: Array, x: Array, instants: Array) -> Array:
    """Return values at given instants by monotone cubics: no overshoot, no kinks.

    Parameters
    ----------
    t : (N,)
        Stamps, s.
    x : (N, …)
        Values at the stamps.
    instants : (K,)
        s.
    """
    return np.asarray(PchipInterpolator(t, x, axis=0)(instants), dtype=np.float64)


def straight_at(t: Array, x: Array, instants: Array) -> Array:
    """Return values at given instants by straight lines, for noisy signals.

    Parameters
    ----------
    t : (N,)
        Stamps, s.
    x : (N, n)
        Values at the stamps.
    instants : (K,)
        s.
    """
    return np.column_stack([np.interp(instants, t, column) for column in x.T])


def decimate(x: Array, rate: float, step: int) -> Array:
    """Return every step-th sample of x (K, ...) after an anti-aliasing zero-phase low-pass.

    Parameters
    ----------
    x : (K, …)
    rate : float
        Of x, Hz.
    step : int
    """
    if step == 1:
        return x
    return lowpass(x, rate, 0.4 * rate / step, order=8)[::step]
