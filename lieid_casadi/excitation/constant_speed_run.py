"""Parts of a friction sweep: runs at constant speed, and the path that they compose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ConstantSpeedRun:
    """From rest to rest: a smooth ramp up to ``speed``, a steady part, a ramp down (s)."""

    speed: float
    ramp: float
    steady: float

    @property
    def travel(self) -> float:
        """Distance of the run, rad."""
        return self.speed * (self.steady + self.ramp)

    @property
    def duration(self) -> float:
        """Time from rest to rest, s."""
        return 2.0 * self.ramp + self.steady

    def at(self, t: Array) -> Array:
        """Return distance, speed and acceleration (3, N) since the start of the run."""
        up = np.clip(t / self.ramp, 0.0, 1.0)
        down = np.clip((t - self.ramp - self.steady) / self.ramp, 0.0, 1.0)
        distance = self.ramp * (_smooth_step_integral(up) + down - _smooth_step_integral(down))
        distance = distance + np.clip(t - self.ramp, 0.0, self.steady)
        slope = (_smooth_step_slope(up) - _smooth_step_slope(down)) / self.ramp
        return np.asarray(
            self.speed * np.stack([distance, _smooth_step(up) - _smooth_step(down), slope])
        )


def _smooth_step(u: Array) -> Array:
    return np.asarray(u**3 * (10.0 - 15.0 * u + 6.0 * u**2))


def _smooth_step_integral(u: Array) -> Array:
    return np.asarray(u**4 * (2.5 - 3.0 * u + u**2))


def _smooth_step_slope(u: Array) -> Array:
    return np.asarray(30.0 * u**2 * (1.0 - u) ** 2)


@dataclass
class MotionPath:
    """Position, speed and acceleration of one joint, composed part by part."""

    rate: float
    time: float = 0.0
    position: float = 0.0

    def __post_init__(self) -> None:
        self.times = [np.zeros(1)]
        self.distances = [np.zeros((3, 1))]

    def add(self, duration: float, distance: Callable[[Array], Array], sign: float = 1.0) -> None:
        """Append a part that moves by ``sign * distance(t)`` from the end of the path.

        Parameters
        ----------
        duration : float
            s.
        distance : callable
            Times (K,) since the start of the part, s → distance and its first two time
            derivatives, rad, rad/s and rad/s².
        sign : float
            Direction, 1 or −1.
        """
        count = max(2, round(duration * self.rate))
        local = duration * np.arange(1, count + 1) / count
        part = sign * distance(local)
        part[0] += self.position
        self.times.append(self.time + local)
        self.distances.append(part)
        self.time += duration
        self.position = float(part[0, -1])
