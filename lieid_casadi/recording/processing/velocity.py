"""Choice between the measured velocity and the derivative of the position, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.recording.arrays import Array, Mask
from lieid_casadi.recording.processing.filtering import decimate
from lieid_casadi.recording.processing.spectrum import noise_dead_zone, noise_spread, resolution

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
class VelocitySource:
    """Source of a segment's velocity, chosen once for the whole segment.

    Attributes
    ----------
    derived, accelerates
        (n,) True where the velocity is the position's derivative; the same for the velocity
        that the acceleration is derived from.
    dead_zone
        (n,) speed below which a joint counts as at rest, rad/s.
    """

    derived: Mask
    accelerates: Mask
    dead_zone: Array


@dataclass(frozen=True, eq=False)
class RawSamples:
    """Uniform, unfiltered samples of one part of a segment, (K, n) each."""

    q: Array
    measured: Array | None
    derivative: Array

    def velocity(self, derived: Mask) -> Array:
        """Return the velocity (K, n), derived where (n,) is set."""
        if self.measured is None:
            return self.derivative
        return np.where(derived, self.derivative, self.measured)


def velocity_source(
    samples: Sequence[RawSamples], rate: float, cutoff: float, band: float
) -> VelocitySource:
    """Choose the source of the velocity from samples of a segment.

    Parameters
    ----------
    rate, cutoff
        Of the samples, and of the filter on columns, Hz.
    band
        Cut-off of the later low-pass of q and dq, Hz.
    """
    dead_zone = _derivative_dead_zone(samples, rate, band)
    given = [part.measured for part in samples if part.measured is not None]
    if not given:
        every = np.ones(len(dead_zone), dtype=bool)
        return VelocitySource(every, every, dead_zone)
    over_band = max(1, int(rate / (RATE_OVER_BAND * band)))
    over_cutoff = max(1, int(rate / (RATE_OVER_CUTOFF * cutoff)))
    derived = MUCH_LESS_NOISE * _derivative_noise(samples, rate, over_band) < _noise(
        given, rate, over_band
    )
    accelerates = LESS_NOISE * _derivative_noise(samples, rate, over_cutoff) < _noise(
        given, rate, over_cutoff
    )
    measured = noise_dead_zone(np.concatenate(given), kept=band / (0.5 * rate))
    return VelocitySource(derived, accelerates, np.where(derived, dead_zone, measured))


def _noise(parts: Sequence[Array], rate: float, step: int) -> Array:
    """Return the noise (n,) of every step-th sample after a low-pass, by fourth differences."""
    return noise_spread([decimate(x, rate, step) for x in parts])


def _derivative_noise(samples: Sequence[RawSamples], rate: float, step: int) -> Array:
    """Return the noise (n,) of the derivative, with its errors of truncation and rounding."""
    slow = [decimate(part.derivative, rate, step) for part in samples]
    # the error of a central difference of step h is h²/6 of the third derivative
    bend = np.concatenate([np.diff(x, n=2, axis=0) for x in slow]) / (6.0 * step**2)
    missed = 1.4826 * np.median(np.abs(bend), axis=0)
    # rounding jumps as often as the motion crosses a quantum, at most every sample
    quantum = resolution(np.concatenate([part.q for part in samples]))
    speed = np.sqrt(np.mean(np.concatenate(slow) ** 2, axis=0))
    share = np.clip(rate / step * quantum / np.maximum(speed, 1e-300), 1.0 / step, 1.0)
    rounding = quantum / np.sqrt(12.0) * np.sqrt(share) * 0.5 * np.pi * rate / step
    return np.asarray(np.sqrt(noise_spread(slow) ** 2 + missed**2 + rounding**2))


def _derivative_dead_zone(samples: Sequence[RawSamples], rate: float, band: float) -> Array:
    """Return the dead zone (n,) of the low-passed derivative; a quantum is one step a period."""
    step = max(1, int(rate / (RATE_OVER_BAND * band)))
    low = np.concatenate([decimate(part.derivative, rate, step) for part in samples])
    quantum = resolution(np.concatenate([part.q for part in samples]))
    kept = min(1.0, band / (0.5 * rate / step))
    return noise_dead_zone(low, kept=kept, quantum=quantum * min(band, 0.5 * rate))
