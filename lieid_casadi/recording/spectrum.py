"""Band of the motion, cut-off frequency and noise of the velocity, estimated from the signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import welch
from scipy.stats import median_abs_deviation

from lieid_casadi.arrays import Array
from lieid_casadi.recording.conversion import is_torque_of_laws
from lieid_casadi.recording.filtering import (
    central_difference,
    decimate,
    lowpass,
    smooth_at,
    straight_at,
    uniform_time,
)
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.repairs import late_velocities, without_repeats

#: Least and most cut-off over the band of the motion.
LEAST_BANDS, MOST_BANDS = 6.0, 25.0
#: Least cut-off over that band if accelerations are noise, by which least squares make inertia
#: smaller: where torque is that of control laws, with no noise of its own, by this part.
LEAST_ACCURATE, NOISE_OF_LAWS = 2.0, 1e-3
#: Rate of the torque from which the cut-off is chosen, Hz: arms do not move at higher frequencies.
TORQUE_RATE = 400.0
#: Frequency, Hz, above which velocities are noise, as of a coarse encoder at a high rate.
HIGHEST_MOTION = 30.0
#: Rows from which the cut-off is chosen: a spectrum needs no more.
ENOUGH_ROWS = 1 << 19
#: Motion, rad or m, and rows that a band is determined from; less is noise about rest.
LEAST_MOTION, LEAST_ROWS = 0.01, 9
#: Least motion, rad or m, from which the band of a joint's torque is estimated.
ENOUGH_MOTION = 0.05
#: Part of the top speed that is in the dead zone even without noise. On test recordings a
#: tenth of it is worse for a TX40, three times as much is worse for a UR10e.
TOP_SPEED_PART = 3e-3
#: Part of a range within which values are the same but for the computer's rounding.
EQUAL = 1e-9


def choose_cutoff(recording: Recording) -> float:
    """Return the cut-off, Hz, up to which the motion explains the torque.

    Each torque is fitted by gravity-like (sines and cosines of all joints), inertia-like and
    friction-like columns. The band ends where the spectrum of the fitted torque falls below that of
    the residual (median over the joints), at least six (without torque: just six) and at most 25
    times the band of the motion (:func:`motion_band`). Accelerations are noise where this is half
    of any joint's residual, or with torque of laws above a thousandth of their power: the cut-off
    is at most there, or twice that band, and a quarter of the rate. Two digits; 5 Hz at rest.
    """
    longest = max(recording.segments(), key=lambda segment: segment.duration)
    longest, _ = without_repeats(longest)
    longest = longest.rows(0, min(len(longest), ENOUGH_ROWS))
    highest = 0.25 * longest.rate
    band = motion_band(longest)
    if band is None:
        return min(5.0, highest)
    if late_velocities(longest, min(LEAST_BANDS * band, highest)).any():
        longest = replace(longest, dq=None)  # filtered: accelerations are derived from positions
    explained, accurate = _explained_bands(longest) or (LEAST_BANDS * band, np.inf)
    cutoff = float(np.clip(explained, LEAST_BANDS * band, MOST_BANDS * band))
    if longest.drives is not None and is_torque_of_laws(longest, longest.drives):
        accurate = min(accurate, _accurate_band(longest, band))
    cutoff = min(cutoff, max(accurate, LEAST_ACCURATE * band))
    return min(float(f"{np.clip(cutoff, min(0.5, highest), highest):.2g}"), highest)


def _accurate_band(recording: Recording, band: float) -> float:
    """Return the frequency up to which noise is a small part of each moving joint's acceleration.

    White noise of positions has the power 2σ²(2π)⁴f⁵/(5·rate) in accelerations below f.
    """
    rate, moving = recording.rate, np.ptp(recording.q, axis=0) > ENOUGH_MOTION
    q = smooth_at(recording.t, recording.q[:, moving], uniform_time(recording.t, rate))
    speed = lowpass(central_difference(q, rate), rate, min(LEAST_ACCURATE * band, 0.4 * rate))
    power = np.mean(central_difference(speed, rate) ** 2, axis=0)
    whole = _density(recording.q[:, moving], q, rate) * (2.0 * np.pi) ** 4 / 5.0
    return float(np.min((NOISE_OF_LAWS * power / np.maximum(whole, 1e-300)) ** 0.2, initial=np.inf))


def _density(recorded: Array, x: Array, rate: float) -> Array:
    """Return the spectral density (n,) of white noise of signals, at least of their rounding."""
    return 2.0 / rate * np.maximum(noise_spread(x) ** 2, resolution(recorded) ** 2 / 12.0)


def _explained_bands(recording: Recording) -> tuple[float, float] | None:
    """Return the frequencies above which noise dominates the torque, and that of accelerations."""
    torque = recording.tau if recording.tau is not None else recording.current
    moving = np.ptp(recording.q, axis=0) > ENOUGH_MOTION
    t, rate = recording.t, recording.rate
    grid, step = uniform_time(t, rate), max(1, int(rate / TORQUE_RATE))
    if torque is None or not moving.any() or len(grid) < LEAST_ROWS * step:
        return None
    q = smooth_at(t, recording.q[:, moving], grid)
    noise = np.array([_density(recording.q[:, moving], q, rate), np.full(q.shape[1], np.inf)])
    q = decimate(q, rate, step)
    tau = decimate(straight_at(t, torque[:, moving], grid), rate, step)
    dq = central_difference(q, rate / step)
    if recording.dq is not None:
        dq = smooth_at(t, recording.dq[:, moving], grid)
        noise[1], dq = _density(recording.dq[:, moving], dq, rate), decimate(dq, rate, step)
    dominated, accelerated = _noise_frequencies(q, dq, tau, rate / step, noise).T
    return float(np.median(dominated)), float(accelerated.min())


def _noise_frequencies(q: Array, dq: Array, tau: Array, rate: float, noise: Array) -> Array:
    """Return where noise (2, n) of q and dq, per Hz, dominates each torque, and its residual."""
    ddq = central_difference(lowpass(dq, rate, min(HIGHEST_MOTION, 0.4 * rate)), rate)
    common = np.hstack([np.ones((q.shape[0], 1)), np.sin(q), np.cos(q), ddq])
    length = min(q.shape[0], max(16, round(4.0 * rate)))
    signs, bands = np.tanh(dq / noise_dead_zone(dq)), []
    for sign, speed, torque in zip(signs.T, dq.T, tau.T, strict=True):
        columns = np.column_stack([common, sign, speed])
        coefficients = np.linalg.lstsq(columns, torque, rcond=None)[0]
        fitted, inertia = columns @ coefficients, coefficients[-2 - q.shape[1] : -2]
        both = np.column_stack([fitted, torque - fitted])
        frequency, density = welch(both, rate, nperseg=length, axis=0)
        ratio = np.log(np.maximum(density[:, 0], 1e-300) / np.maximum(density[:, 1], 1e-300))
        ratio = np.convolve(ratio, np.full(5, 0.2), "same")
        squares = (2.0 * np.pi * frequency[:, None]) ** 2
        own = squares * np.minimum(squares * noise[0], noise[1]) @ inertia**2
        # the lowest bins are blurred by the window and by the mean
        noisy = np.column_stack([ratio < 0.0, own > 0.5 * density[:, 1]])
        noisy[:3], noisy[-3:] = False, True
        bands.append(frequency[np.argmax(noisy, axis=0)])
    return np.array(bands)


def motion_band(recording: Recording) -> float | None:
    """Return the frequency, Hz, below which 99 % of the velocity's power lies; None at rest."""
    longest = max(recording.segments(), key=len)
    moves = np.ptp(longest.q, axis=0) > LEAST_MOTION
    if len(longest) < LEAST_ROWS or not moves.any():
        return None
    rate, grid = longest.rate, uniform_time(longest.t, longest.rate)
    q = smooth_at(longest.t, longest.q[:, moves], grid)
    rounding = resolution(longest.q[:, moves]) ** 2 / 12.0
    bands = [_band(central_difference(q, rate), rate, rounding=rounding)]
    if longest.dq is not None:
        bands.append(_band(smooth_at(longest.t, longest.dq[:, moves], grid), rate))
    return min((band for band in bands if band is not None), default=None)


def _band(dq: Array, rate: float, *, rounding: Array | None = None) -> float | None:
    """Return the frequency below which 99 % of the power of velocities lies, median over joints.

    ``rounding`` (n,) is the variance of white rounding errors of the positions whose central
    differences ``dq`` are; their power is subtracted, which for coarse encoders exceeds 1 %.
    """
    power = np.mean(dq**2, axis=0)
    moves = power > 1e-3 * power.max()
    if not moves.any():
        return None
    length = min(dq.shape[0], round(8.0 * rate))
    frequency, density = welch(dq[:, moves], rate, nperseg=length, axis=0)
    density[frequency > HIGHEST_MOTION] = 0.0
    if rounding is not None:
        gain = (rate * np.sin(2.0 * np.pi * frequency / rate)) ** 2
        noise = gain[:, None] * rounding[moves] * 2.0 / rate
        # the estimated density scatters about that of the noise: bins within it are noise
        density = np.where(density > 4.0 * noise, density - noise, 0.0)
    if not (density[1:].sum(axis=0) > 0.0).all():  # shorter than a period, or of one speed
        return None
    below = np.cumsum(density, axis=0) / density.sum(axis=0)
    return float(max(np.median(frequency[np.argmax(below >= 0.99, axis=0)]), frequency[1]))


def noise_dead_zone(dq: Array, *, kept: float = 1.0, quantum: Array | None = None) -> Array:
    """Return the speed below which a joint counts as at rest, per joint.

    Three standard deviations of the velocity's noise, which is the robust spread of the
    fourth difference of dq (that of motion is negligible, that of white noise √70 σ), but at
    least 1.5 steps of dq's resolution and 0.3 % of the joint's top speed: a reversal passes
    through that within about a sample, and the sign there is undetermined.

    ``kept`` is the part of the band below Nyquist that a later low-pass keeps, with whose square
    root the noise falls; ``quantum`` (n,) the resolution where it is not the smallest step.
    """
    noise = 3.0 * noise_spread(dq) * np.sqrt(min(kept, 1.0))
    top = np.percentile(np.abs(dq), 99.0, axis=0)
    step = resolution(dq) if quantum is None else quantum
    return np.asarray(np.maximum.reduce([noise, 1.5 * step, TOP_SPEED_PART * top, 0 * top + 1e-6]))


def noise_spread(x: Array) -> Array:
    """Return the standard deviation (n,) of white noise on a signal (N, n); 0 of a short one."""
    if x.shape[0] <= 8:
        return np.zeros(x.shape[1])
    fourth = np.diff(x, n=4, axis=0)
    return np.asarray(median_abs_deviation(fourth, scale="normal") / np.sqrt(70.0))


def resolution(values: Array) -> Array:
    """Return the smallest step (n,) between values that are not equal but for rounding."""
    steps = [np.diff(np.unique(column)) for column in values.T]
    least = [own[own > EQUAL * own.sum()].min(initial=np.inf) for own in steps]
    return np.where(np.isfinite(least), least, 0.0)


def rounded_as(recorded: Array, values: Array) -> Array:
    """Return values (N, n) rounded by the quantum of what was recorded, half a step off."""
    step = np.maximum(resolution(recorded), 1e-15)
    return np.asarray((np.floor(values / step) + 0.5) * step)
