"""Noise floor: the RMS error that a perfect model would have after the fit's filter.

This is the definition for comparisons and diagnoses. The noise is estimated from the difference
between periods if a recording is periodic (`period_noise`), otherwise from the spectrum of the
error above the cut-off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from scipy.signal import butter, sosfreqz, welch

from lieid_casadi.recording import Recording, period_noise
from lieid_casadi.recording.processing.process import Processed

Array = NDArray[np.float64]
# Band with noise alone: above the pass band of the filter, below the frequencies that resampling
# and decimation attenuate. In units of the cut-off and of the sampling rate.
FROM_CUTOFF, FROM_RATE, TO_RATE = 1.5, 0.25, 0.35
FEWEST_FREQUENCIES = 3  # in that band
SEGMENT_LENGTH = 1024  # samples, of Welch's method

SOURCES = {
    "period_to_period": "differences between periods of the motion",
    "high_frequency": "spectrum of the error above the cut-off, a lower bound",
    "none": "not available",
}


def noise_floor(
    recordings: Sequence[Recording],
    segments: Sequence[Processed],
    raw_errors: Sequence[Array],
) -> tuple[Array, str]:
    """Return the noise of the torque after the fit's filter (n,), N·m, and its source.

    Parameters
    ----------
    recordings : sequence of Recording
        If the motion of at least one is periodic, its periods are compared with each other.
    segments : sequence of Processed
        Of the recordings.
    raw_errors : sequence of (K, n)
        Measured − predicted torque of each segment, not filtered, N·m. Without periods its
        spectral density above the cut-off is extrapolated to the pass band as for white noise.
        Noise with more power at low frequencies is underestimated, often several times.

    Returns
    -------
    (n,) ndarray
        NaN if neither estimate is possible.
    str
        Key of `SOURCES`.
    """
    cutoff = segments[0].cutoff
    repeated = [(period_noise(r, cutoff=cutoff), r.duration) for r in recordings]
    periodic = [(noise, duration) for noise, duration in repeated if noise is not None]
    if periodic:
        return _pooled(periodic), "period_to_period"
    floors = [
        (_high_frequency_noise(segment, error), float(segment.t[-1] - segment.t[0]))
        for segment, error in zip(segments, raw_errors, strict=True)
    ]
    usable = [(floor, duration) for floor, duration in floors if floor is not None]
    if not usable:
        return np.full(segments[0].n, np.nan), "none"
    return _pooled(usable), "high_frequency"


def _pooled(parts: Sequence[tuple[Array, float]]) -> Array:
    """Return the root of the mean square (n,), weighted by duration."""
    squares = [values**2 for values, _ in parts]
    durations = [duration for _, duration in parts]
    return np.asarray(np.sqrt(np.average(squares, axis=0, weights=durations)))


def _high_frequency_noise(segment: Processed, error: Array) -> Array | None:
    """Return the noise (n,) of white noise with the density above the cut-off; None if unknown."""
    if segment.options.smoother != "butterworth":
        return None  # robust smoothing has removed the high frequencies
    low = min(FROM_CUTOFF * segment.cutoff, FROM_RATE * segment.rate)
    high = TO_RATE * segment.rate
    if low < segment.cutoff:
        return None
    frequency, density = welch(error, segment.rate, nperseg=min(len(error), SEGMENT_LENGTH), axis=0)
    band = (frequency >= low) & (frequency <= high)
    if band.sum() < FEWEST_FREQUENCIES:
        return None
    level = np.median(density[band], axis=0)  # not sensitive to lines of drive harmonics
    variance = level * noise_bandwidth(segment.rate, segment.cutoff, segment.options.order)
    return np.asarray(np.sqrt(variance))


def noise_bandwidth(rate: float, cutoff: float, order: int) -> float:
    """Return the noise bandwidth of the zero-phase low-pass, ∫|H|⁴ df, Hz.

    Parameters
    ----------
    rate, cutoff : float
        Hz.
    order : int
        Of the Butterworth filter, which is applied forward and backward.
    """
    sections = butter(order, cutoff, fs=rate, output="sos")
    frequency, response = sosfreqz(sections, worN=4096, fs=rate)
    return float(trapezoid(np.abs(response) ** 4, frequency))
