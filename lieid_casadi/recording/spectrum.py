"""What the signals themselves say: band of the motion, period, noise of the velocity."""

from __future__ import annotations

import numpy as np
from scipy.signal import welch

from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.filtering import central_difference, smooth_at, uniform_time
from lieid_casadi.recording.recording import Recording

#: Cut-off over the frequency below which 99 % of the velocity's power lies.
BAND_FACTOR = 6.0


def choose_cutoff(recording: Recording) -> float:
    """Cut-off, Hz, that keeps the band in which the motion lives.

    Six times the band of the motion (:func:`motion_band`): harmonics of the torque, such as
    the steps of friction, are kept; what the motion cannot explain is not. Between 0.5 Hz
    and a quarter of the rate; 5 Hz where nothing moves.
    """
    highest = 0.25 * recording.rate
    band = motion_band(recording)
    if band is None:
        return float(min(5.0, highest))
    return float(np.clip(BAND_FACTOR * band, min(0.5, highest), highest))


def motion_band(recording: Recording) -> float | None:
    """Frequency, Hz, below which 99 % of the velocity's power lies; None at rest.

    Median over the joints that move; the lower one of measured velocity and differenced
    position, since either may be noisy.
    """
    rate = recording.rate
    grid = uniform_time(recording.t, rate)
    derived = central_difference(smooth_at(recording.t, recording.q, grid), rate)
    bands = [_band(derived, rate)]
    if recording.dq is not None:
        bands.append(_band(smooth_at(recording.t, recording.dq, grid), rate))
    return min((band for band in bands if band is not None), default=None)


def _band(dq: Array, rate: float) -> float | None:
    power = np.mean(dq**2, axis=0)
    moves = power > 1e-3 * power.max()
    if not moves.any():
        return None
    length = min(dq.shape[0], round(8.0 * rate))
    frequency, density = welch(dq[:, moves], rate, nperseg=length, axis=0)
    below = np.cumsum(density, axis=0) / density.sum(axis=0)
    return float(np.median(frequency[np.argmax(below >= 0.99, axis=0)]))


def noise_dead_zone(dq: Array, *, kept: float = 1.0) -> Array:
    """Speed below which a joint counts as at rest, per joint.

    Three standard deviations of the velocity's noise, which is the robust spread of the
    fourth difference of dq (motion leaves nothing there, white noise √70 σ), but at least
    1.5 steps of dq's resolution and a thousandth of the joint's top speed.

    Parameters
    ----------
    dq
        (N, n) rad/s, uniform samples.
    kept
        Part of the band below Nyquist that a later low-pass keeps: the noise falls with
        its square root.

    Returns
    -------
    (n,) rad/s, never 0.
    """
    spread = np.zeros(dq.shape[1])
    if dq.shape[0] > 8:
        fourth = np.diff(dq, n=4, axis=0)
        spread = 1.4826 * np.median(np.abs(fourth - np.median(fourth, axis=0)), axis=0)
    noise = 3.0 * spread / np.sqrt(70.0) * np.sqrt(min(kept, 1.0))
    top = np.percentile(np.abs(dq), 99.0, axis=0)
    resolution = np.array([_resolution(column) for column in dq.T])
    return np.asarray(np.maximum.reduce([noise, 1.5 * resolution, 1e-3 * top, 0 * top + 1e-6]))


def _resolution(values: Array) -> float:
    """Smallest step between distinct values: the quantum, or next to nothing."""
    distinct = np.unique(values)
    return float(np.min(np.diff(distinct))) if distinct.size > 1 else 0.0
