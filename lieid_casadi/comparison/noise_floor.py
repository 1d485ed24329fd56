"""How large the error of a perfect model would be: the noise of the measured torque."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from scipy.signal import butter, sosfreqz, welch

from lieid_casadi.recording import Recording, period_noise
from lieid_casadi.recording.processing.process import Processed

Array = NDArray[np.float64]
# Band that shows noise and nothing else: above what the filter lets through, below where
# resampling and decimation weaken it. Parts of the cut-off and of the rate.
FROM_CUTOFF, FROM_RATE, TO_RATE = 1.5, 0.25, 0.35


def noise_floor(
    recordings: Sequence[Recording],
    segments: Sequence[Processed],
    raw_errors: Sequence[Array],
) -> tuple[Array, str]:
    """Estimate the noise (n,) that the fit's filter leaves of the torque, N·m.

    Parameters
    ----------
    recordings
        Where the motion of one is periodic, periods are compared: ``period_to_period``.
    segments, raw_errors
        Measured − predicted torque (K, n) on each segment's grid. Without periods, its
        density above the cut-off is taken to continue below, as it does for white noise:
        ``high_frequency``. Noise that is stronger at low frequencies is underestimated, often
        several times.

    Returns
    -------
    (n,) float
        NaN where neither is possible.
    str
        ``period_to_period``, ``high_frequency`` or ``none``.
    """
    cutoff = segments[0].cutoff
    repeated = [(period_noise(r, cutoff=cutoff), r.duration) for r in recordings]
    periodic = [(noise, duration) for noise, duration in repeated if noise is not None]
    if periodic:
        return _mean_square([n for n, _ in periodic], [d for _, d in periodic]), "period_to_period"
    floors = [
        _high_frequency(segment, error) for segment, error in zip(segments, raw_errors, strict=True)
    ]
    lengths = [segment.t[-1] - segment.t[0] for segment in segments]
    usable = [k for k, floor in enumerate(floors) if floor is not None]
    if not usable:
        return np.full(segments[0].n, np.nan), "none"
    kept = [floor for floor in floors if floor is not None]
    return _mean_square(kept, [lengths[k] for k in usable]), "high_frequency"


def _mean_square(values: Sequence[Array], weights: Sequence[float]) -> Array:
    squares = np.average(np.square(values), axis=0, weights=np.asarray(weights))
    return np.asarray(np.sqrt(squares))


def _high_frequency(segment: Processed, error: Array) -> Array | None:
    """White noise of the density above the cut-off, through the filter (n,)."""
    if segment.options.smoother != "butterworth":
        return None  # robust smoothing has taken the high frequencies away
    low = min(FROM_CUTOFF * segment.cutoff, FROM_RATE * segment.rate)
    high = TO_RATE * segment.rate
    if low < segment.cutoff:
        return None
    length = min(len(error), 1024)
    frequency, density = welch(error, segment.rate, nperseg=length, axis=0)
    band = (frequency >= low) & (frequency <= high)
    if band.sum() < 3:
        return None
    level = np.median(density[band], axis=0)  # drive harmonics are lines, noise is not
    variance = level * passed_bandwidth(segment.rate, segment.cutoff, segment.options.order)
    return np.asarray(np.sqrt(variance))


def passed_bandwidth(rate: float, cutoff: float, order: int) -> float:
    """Noise bandwidth, Hz, of the low-pass forward and backward: ∫|H|⁴ df."""
    sections = butter(order, cutoff, fs=rate, output="sos")
    frequency, response = sosfreqz(sections, worN=4096, fs=rate)
    return float(trapezoid(np.abs(response) ** 4, frequency))
