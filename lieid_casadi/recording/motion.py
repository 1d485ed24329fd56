"""Position, velocity and acceleration on a uniform grid, from the measured or derived velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_opening

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.recording.filtering import (
    central_difference,
    decimate,
    lowpass,
    sixth_order_difference,
    smooth_at,
)
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.spectrum import noise_dead_zone, noise_spread, resolution

#: Least time in the dead zone, s, that counts as rest (stiction holds the joint).
REST_TIME = 0.03
#: Band of q, dq and ddq in cut-offs, and least band in Hz: the filter of the columns alone limits
#: the band further, and the duration of reversals and rests does not depend on the cut-off.
MOTION_BAND, LEAST_BAND = 3.0, 20.0
#: The derivative replaces the measured velocity if its noise over the band of the motion is lower
#: by this factor: it contains no motion between two samples.
MUCH_LESS_NOISE = 2.0
#: The acceleration is computed from it if its noise at the cut-off is lower by this factor:
#: differences amplify noise, and the columns' filter removes higher frequencies.
LESS_NOISE = 1.2
#: Rates at which noise is compared, in cut-offs and in bands of the motion: it is then that of
#: the upper half below Nyquist, where motion leaves little.
RATE_OVER_CUTOFF, RATE_OVER_BAND = 4.0, 2.5


@dataclass(frozen=True, eq=False)
class Motion:
    """Low-passed motion of one segment, (K, n) each; see `Processed`."""

    q: Array
    dq: Array
    ddq: Array
    moving: Mask
    dead_zone: Array  # (n,)


def motion_at(part: Recording, times: Array, cutoff: float) -> Motion:
    """Return the motion of a segment at uniform times (K,), s, for a cut-off of the columns, Hz."""
    rate = (times.size - 1) / float(times[-1] - times[0])
    band = max(MOTION_BAND * cutoff, LEAST_BAND)
    q = smooth_at(part.t, part.q, times)
    derivative = central_difference(q, rate)
    dead_zone = _derivative_dead_zone(q, derivative, rate, band)
    velocity, for_acceleration = derivative, None
    if part.dq is not None:
        measured = smooth_at(part.t, part.dq, times)

        def is_better(factor: float, frequency: float) -> Mask:
            """Mark joints (n,) whose derivative has less noise at a rate than the velocity."""
            step = max(1, int(rate / frequency))
            noise = noise_spread(decimate(measured, rate, step))
            return np.asarray(factor * _derivative_noise(q, derivative, rate, step) < noise)

        derived = is_better(MUCH_LESS_NOISE, RATE_OVER_BAND * band)
        velocity = np.where(derived, derivative, measured)
        better = is_better(LESS_NOISE, RATE_OVER_CUTOFF * cutoff)
        if not np.array_equal(derived, better):
            for_acceleration = np.where(better, derivative, measured)
        own = noise_dead_zone(measured, kept=band / (0.5 * rate))
        dead_zone = np.where(derived, dead_zone, own)
    dq = lowpass(velocity, rate, band)
    if part.ddq is not None:
        ddq = lowpass(smooth_at(part.t, part.ddq, times), rate, band)
    elif for_acceleration is None:
        ddq = central_difference(dq, rate)
        if part.command is not None and part.dq is None:
            # commands are recorded at low rates, and their torque is as exact as the positions
            exact = lowpass(sixth_order_difference(q, rate), rate, band)
            ddq = sixth_order_difference(exact, rate)
    else:
        ddq = central_difference(lowpass(for_acceleration, rate, band), rate)
    moving = _moving(dq, dead_zone, rate)
    return Motion(lowpass(q, rate, band), np.where(moving, dq, 0.0), ddq, moving, dead_zone)


def _moving(dq: Array, dead_zone: Array, rate: float) -> Mask:
    """Mark (K, n) where joints do not rest.

    Dry friction is undetermined where stiction holds a joint, even for an instant at a reversal.
    A reversal without stiction passes through the dead zone sooner, and there the velocity's own
    sign is the best estimate.
    """
    structure = np.ones((max(round(rate * REST_TIME), 2), 1), dtype=bool)
    rest = binary_opening(np.abs(dq) <= dead_zone, structure=structure)
    return np.asarray(~rest)


def _derivative_noise(q: Array, derivative: Array, rate: float, step: int) -> Array:
    """Return the noise (n,) of the derivative, with its errors of truncation and rounding."""
    slow = decimate(derivative, rate, step)
    # the error of a central difference of step h is h²/6 of the third derivative
    bend = np.diff(slow, n=2, axis=0) / (6.0 * step**2)
    missed = 1.4826 * np.median(np.abs(bend), axis=0)
    # rounding jumps as often as the motion crosses a quantum, at most every sample
    quantum = resolution(q)
    speed = np.sqrt(np.mean(slow**2, axis=0))
    share = np.clip(rate / step * quantum / np.maximum(speed, 1e-300), 1.0 / step, 1.0)
    rounding = quantum / np.sqrt(12.0) * np.sqrt(share) * 0.5 * np.pi * rate / step
    return np.asarray(np.sqrt(noise_spread(slow) ** 2 + missed**2 + rounding**2))


def _derivative_dead_zone(q: Array, derivative: Array, rate: float, band: float) -> Array:
    """Return the dead zone (n,) of the low-passed derivative; a quantum is one step a period."""
    step = max(1, int(rate / (RATE_OVER_BAND * band)))
    low = decimate(derivative, rate, step)
    kept = min(1.0, band / (0.5 * rate / step))
    return noise_dead_zone(low, kept=kept, quantum=resolution(q) * min(band, 0.5 * rate))
