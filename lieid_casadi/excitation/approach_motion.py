"""The way from the arm's rest pose into the trajectory, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.excitation.limits.constraint_sets import ConstraintSet
from lieid_casadi.excitation.limits.joint_limits import MotionRange

Array = NDArray[np.float64]
PEAK_VELOCITY, PEAK_ACCELERATION = 1.875, 5.7736  # of the quintic from 0 to 1 in 1 s
SPARE = 1.05  # slower than the limits ask for
SLOWER = (1.0, 1.5, 2.5, 4.0)  # durations that are tried, in parts of the quickest
GRID = 400


@dataclass(frozen=True, eq=False)
class RestToRest:
    """A quintic from rest to rest between two poses (n,)."""

    start: Array
    end: Array
    duration: float

    def at(self, t: Array) -> MotionSamples:
        """Return the motion at times 0 … duration."""
        if self.duration <= 0.0:
            raise ValueError("a run-in without duration has no motion")
        u = np.clip(np.asarray(t) / self.duration, 0.0, 1.0)[:, None]
        way, rate = self.end - self.start, 1.0 / self.duration
        shape = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        first = 30.0 * u**2 * (1.0 - u) ** 2 * rate
        second = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) * rate**2
        return MotionSamples(np.asarray(t), self.start + shape * way, first * way, second * way)


def approach_motion(
    rest: Array,
    start: Array,
    limits: MotionRange,
    sets: Sequence[ConstraintSet],
    *,
    step: float = 1e-3,
) -> RestToRest:
    """Return the way from the rest pose to the trajectory's start, within all limits.

    Its duration is a multiple of ``step`` (s), so that samples end at rest.

    Raises
    ------
    NoSolution
        Names the limit that the straight way breaks however slow it is.
    """
    way = np.abs(start - rest)
    if not way.max() > 1e-9:
        return RestToRest(rest, start, 0.0)
    quickest = SPARE * max(
        float(np.max(PEAK_VELOCITY * way / limits.velocity)),
        float(np.max(np.sqrt(PEAK_ACCELERATION * way / limits.acceleration))),
    )
    broken = ""
    for factor in SLOWER:
        path = RestToRest(rest, start, float(np.ceil(factor * quickest / step)) * step)
        broken = _broken(path, sets)
        if not broken:
            return path
    raise NoSolution(
        f"the way from the rest pose to the trajectory's start breaks a limit: {broken}; "
        "give a start pose that is free on all sides (--start-pose) and start there"
    )


def _broken(path: RestToRest, sets: Sequence[ConstraintSet]) -> str:
    motion = path.at(np.linspace(0.0, path.duration, GRID))
    for limits in sets:
        excess = limits.excess(limits.values(motion))
        k, sample = np.unravel_index(int(np.argmax(excess)), excess.shape)
        if excess[k, sample] > 0.0:
            return (
                f"{limits.labels[k]} by {excess[k, sample]:.3g} {limits.units[k]} "
                f"at {motion.t[sample]:.3g} s"
            )
    return ""
