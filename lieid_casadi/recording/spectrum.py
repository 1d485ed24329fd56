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

    Six times the frequency below which 99 % of the velocity's power lies (median over the
    joints that move): harmonics of the torque, such as the steps of friction, are kept;
    what the motion cannot explain is not. Between 0.5 Hz and a quarter of the rate.
    """
    rate = recording.rate
    grid = uniform_time(recording.t, rate)
    if recording.dq is not None:
        dq = smooth_at(recording.t, recording.dq, grid)
    else:
        dq = central_difference(smooth_at(recording.t, recording.q, grid), rate)
    power = np.mean(dq**2, axis=0)
    moves = power > 1e-4 * power.max() if power.max() > 0.0 else np.zeros(power.size, bool)
    if not moves.any():
        return float(min(5.0, 0.25 * rate))
    length = min(grid.size, round(8.0 * rate))
    frequency, density = welch(dq[:, moves], rate, nperseg=length, axis=0)
    below = np.cumsum(density, axis=0) / density.sum(axis=0)
    highest = frequency[np.argmax(below >= 0.99, axis=0)]
    return float(np.clip(BAND_FACTOR * np.median(highest), 0.5, 0.25 * rate))


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
