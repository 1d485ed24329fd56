"""Signals of one segment on a uniform grid, and the source of its velocity, joint by joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_opening

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.recording.filtering import (
    central_difference,
    decimate,
    lowpass,
    robust_loess,
    smooth_at,
    straight_at,
    uniform_time,
)
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.spectrum import noise_dead_zone, noise_spread, resolution

#: Least time in the dead zone, s, that counts as rest (stiction holds the joint).
REST_TIME = 0.03
#: Band of q, dq and ddq in cut-offs, and least band in Hz: the filter of the columns alone limits
#: the band further, and the duration of reversals and rests does not depend on the cut-off.
MOTION_BAND, LEAST_BAND = 3.0, 20.0
#: Least rate of the grid, in cut-offs and in Hz, so that steps of sgn(dq) stay sharp.
GRID_OVER_CUTOFF, LEAST_GRID = 20.0, 120.0
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
class GridSignals:
    """Signals of one segment, (K, …) on every step-th instant of the grid; see `Processed`."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array | None
    temperature: Array | None
    command: Array | None
    moving: Mask
    dead_zone: Array
    rate: float


def signals_on_grid(
    part: Recording, rate: float, cutoff: float, *, loess: bool = False
) -> GridSignals:
    """Return resampled, low-passed and differentiated signals of one segment.

    Parameters
    ----------
    part
        The segment.
    rate, cutoff
        Of the grid before every step-th instant is kept, and of the columns, Hz.
    loess
        Smooth ddq and tau by robust local regression.
    """
    times = uniform_time(part.t, rate)
    rate = (times.size - 1) / float(part.t[-1] - part.t[0])
    step = max(1, int(rate / max(GRID_OVER_CUTOFF * cutoff, LEAST_GRID)))
    band = signal_band(cutoff)
    raw = _raw_samples(part, times, rate)
    velocity = velocity_source(raw, rate, cutoff, band)
    dq = lowpass(raw.velocity(velocity.derived), rate, band)
    if part.ddq is not None:
        ddq = lowpass(smooth_at(part.t, part.ddq, times), rate, band)
    elif np.array_equal(velocity.derived, velocity.accelerates):
        ddq = central_difference(dq, rate)
    else:
        ddq = central_difference(lowpass(raw.velocity(velocity.accelerates), rate, band), rate)
    tau = None if part.tau is None else straight_at(part.t, part.tau, times)
    if loess:
        ddq = robust_loess(times, ddq, cutoff)
        tau = None if tau is None else robust_loess(times, tau, cutoff)
    if tau is not None:
        tau = _read_only(decimate(tau, rate, step))
    moving = _moving(dq, velocity.dead_zone, rate)

    def straight(values: Array | None) -> Array | None:
        return None if values is None else _read_only(straight_at(part.t, values, times)[::step])

    return GridSignals(
        t=_read_only(times[::step]),
        q=_read_only(lowpass(raw.q, rate, band)[::step]),
        dq=_read_only(np.where(moving, dq, 0.0)[::step]),
        ddq=_read_only(ddq[::step]),
        tau=tau,
        temperature=straight(part.temperature),
        command=straight(part.command),
        moving=moving[::step],
        dead_zone=velocity.dead_zone,
        rate=rate / step,
    )


def signal_band(cutoff: float) -> float:
    """Return the band of q, dq and ddq, Hz, for a cut-off of the columns."""
    return max(MOTION_BAND * cutoff, LEAST_BAND)


def _read_only(values: Array) -> Array:
    """Return a contiguous array that results can share."""
    array = np.ascontiguousarray(values)
    array.flags.writeable = False
    return array


def _raw_samples(part: Recording, times: Array, rate: float) -> RawSamples:
    q = smooth_at(part.t, part.q, times)
    measured = None if part.dq is None else smooth_at(part.t, part.dq, times)
    return RawSamples(q, measured, central_difference(q, rate))


def _moving(dq: Array, dead_zone: Array, rate: float) -> Mask:
    """Mark (K, n) where joints do not rest.

    Dry friction is undetermined where stiction holds a joint, even for an instant at a reversal.
    A reversal without stiction passes through the dead zone sooner, and there the velocity's own
    sign is the best estimate.
    """
    structure = np.ones((max(round(rate * REST_TIME), 2), 1), dtype=bool)
    rest = binary_opening(np.abs(dq) <= dead_zone, structure=structure)
    return np.asarray(~rest)


@dataclass(frozen=True, eq=False)
class VelocitySource:
    """Source of a segment's velocity, chosen once for the whole segment."""

    derived: Mask  # (n,) where the velocity is the position's derivative
    accelerates: Mask  # (n,) where the acceleration is derived from that
    dead_zone: Array  # (n,) speed below which a joint counts as at rest, rad/s


@dataclass(frozen=True, eq=False)
class RawSamples:
    """Uniform, unfiltered samples of a segment, (K, n) each."""

    q: Array
    measured: Array | None
    derivative: Array

    def velocity(self, derived: Mask) -> Array:
        """Return the velocity (K, n), derived where (n,) is set."""
        if self.measured is None:
            return self.derivative
        return np.where(derived, self.derivative, self.measured)


def velocity_source(samples: RawSamples, rate: float, cutoff: float, band: float) -> VelocitySource:
    """Choose the source of the velocity from the samples of a segment.

    Parameters
    ----------
    rate, cutoff
        Of the samples, and of the filter on columns, Hz.
    band
        Cut-off of the later low-pass of q and dq, Hz.
    """
    dead_zone = _derivative_dead_zone(samples, rate, band)
    given = samples.measured
    if given is None:
        every = np.ones(len(dead_zone), dtype=bool)
        return VelocitySource(every, every, dead_zone)

    def derivative_is_better(factor: float, frequency: float) -> Mask:
        step = max(1, int(rate / frequency))
        noise = noise_spread(decimate(given, rate, step))
        return np.asarray(factor * _derivative_noise(samples, rate, step) < noise)

    derived = derivative_is_better(MUCH_LESS_NOISE, RATE_OVER_BAND * band)
    accelerates = derivative_is_better(LESS_NOISE, RATE_OVER_CUTOFF * cutoff)
    measured = noise_dead_zone(given, kept=band / (0.5 * rate))
    return VelocitySource(derived, accelerates, np.where(derived, dead_zone, measured))


def _derivative_noise(samples: RawSamples, rate: float, step: int) -> Array:
    """Return the noise (n,) of the derivative, with its errors of truncation and rounding."""
    slow = decimate(samples.derivative, rate, step)
    # the error of a central difference of step h is h²/6 of the third derivative
    bend = np.diff(slow, n=2, axis=0) / (6.0 * step**2)
    missed = 1.4826 * np.median(np.abs(bend), axis=0)
    # rounding jumps as often as the motion crosses a quantum, at most every sample
    quantum = resolution(samples.q)
    speed = np.sqrt(np.mean(slow**2, axis=0))
    share = np.clip(rate / step * quantum / np.maximum(speed, 1e-300), 1.0 / step, 1.0)
    rounding = quantum / np.sqrt(12.0) * np.sqrt(share) * 0.5 * np.pi * rate / step
    return np.asarray(np.sqrt(noise_spread(slow) ** 2 + missed**2 + rounding**2))


def _derivative_dead_zone(samples: RawSamples, rate: float, band: float) -> Array:
    """Return the dead zone (n,) of the low-passed derivative; a quantum is one step a period."""
    step = max(1, int(rate / (RATE_OVER_BAND * band)))
    low = decimate(samples.derivative, rate, step)
    kept = min(1.0, band / (0.5 * rate / step))
    return noise_dead_zone(low, kept=kept, quantum=resolution(samples.q) * min(band, 0.5 * rate))
