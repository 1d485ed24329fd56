"""Which velocity to believe, joint by joint: the measured one, or the position's derivative."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.recording.arrays import Array, Mask
from lieid_casadi.recording.processing.filtering import decimate
from lieid_casadi.recording.processing.spectrum import noise_dead_zone, noise_spread, resolution

#: The position's derivative takes the measured velocity's place if it is this much quieter over
#: the band of the motion: it knows nothing of what happens within a sample.
MUCH_QUIETER = 2.0
#: The acceleration is derived from it if it is this much quieter at the cut-off: differences
#: raise what noise there is, and the columns' filter leaves little beyond.
QUIETER = 1.2
#: Rates at which noise is compared, in cut-offs and in bands of the motion: it is then that of
#: the upper half below Nyquist, where motion leaves little.
RATE_OVER_CUTOFF, RATE_OVER_BAND = 4.0, 2.5


@dataclass(frozen=True, eq=False)
class Velocity:
    """Where a segment's velocity comes from, decided once for all of it.

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
class Look:
    """Uniform samples at one place of a segment, (K, n) each: the raw signals, nothing filtered."""

    q: Array
    measured: Array | None
    derivative: Array

    def velocity(self, derived: Mask) -> Array:
        """Return the velocity (K, n), derived where (n,) is set."""
        if self.measured is None:
            return self.derivative
        return np.where(derived, self.derivative, self.measured)


def velocity_of(looks: Sequence[Look], rate: float, cutoff: float, band: float) -> Velocity:
    """Decide by what is seen at some places of a segment.

    Parameters
    ----------
    rate, cutoff
        Of the samples, and of the filter on columns, Hz.
    band
        What a low-pass will keep of q and dq, Hz.
    """
    dead_zone = _derivative_dead_zone(looks, rate, band)
    given = [look.measured for look in looks if look.measured is not None]
    if not given:
        every = np.ones(len(dead_zone), dtype=bool)
        return Velocity(every, every, dead_zone)
    over_band = max(1, int(rate / (RATE_OVER_BAND * band)))
    over_cutoff = max(1, int(rate / (RATE_OVER_CUTOFF * cutoff)))
    derived = MUCH_QUIETER * _derivative_noise(looks, rate, over_band) < _noise(
        given, rate, over_band
    )
    accelerates = QUIETER * _derivative_noise(looks, rate, over_cutoff) < _noise(
        given, rate, over_cutoff
    )
    measured = noise_dead_zone(np.concatenate(given), kept=band / (0.5 * rate))
    return Velocity(derived, accelerates, np.where(derived, dead_zone, measured))


def _noise(places: Sequence[Array], rate: float, step: int) -> Array:
    """Noise (n,) of every step-th sample behind a low-pass, by fourth differences."""
    return noise_spread([decimate(x, rate, step) for x in places])


def _derivative_noise(looks: Sequence[Look], rate: float, step: int) -> Array:
    """The same of the derivative, with what differences miss of the motion, and its quanta."""
    slow = [decimate(look.derivative, rate, step) for look in looks]
    # a central difference of step h lacks h²/6 of the third derivative
    bend = np.concatenate([np.diff(x, n=2, axis=0) for x in slow]) / (6.0 * step**2)
    missed = 1.4826 * np.median(np.abs(bend), axis=0)
    # rounding jumps as often as the motion crosses a quantum, at most every sample
    quantum = resolution(np.concatenate([look.q for look in looks]))
    speed = np.sqrt(np.mean(np.concatenate(slow) ** 2, axis=0))
    share = np.clip(rate / step * quantum / np.maximum(speed, 1e-300), 1.0 / step, 1.0)
    rounding = quantum / np.sqrt(12.0) * np.sqrt(share) * 0.5 * np.pi * rate / step
    return np.asarray(np.sqrt(noise_spread(slow) ** 2 + missed**2 + rounding**2))


def _derivative_dead_zone(looks: Sequence[Look], rate: float, band: float) -> Array:
    """Dead zone (n,) of the low-passed derivative; a position's quantum is one step a period."""
    step = max(1, int(rate / (RATE_OVER_BAND * band)))
    low = np.concatenate([decimate(look.derivative, rate, step) for look in looks])
    quantum = resolution(np.concatenate([look.q for look in looks]))
    kept = min(1.0, band / (0.5 * rate / step))
    return noise_dead_zone(low, kept=kept, quantum=quantum * min(band, 0.5 * rate))
