"""The motion from the rest pose to the start of the trajectory; backwards, the return."""

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
MARGIN = 1.05  # on the shortest duration that the joint limits permit
DURATIONS = (1.0, 1.5, 2.5, 4.0)  # that are tried, in parts of the shortest
GRID = 400  # samples of the verification


@dataclass(frozen=True, eq=False)
class RestToRest:
    """A quintic motion from rest to rest.

    Attributes
    ----------
    start, end : (n,)
        Poses, rad.
    duration : float
        s.
    """

    start: Array
    end: Array
    duration: float

    def at(self, t: Array) -> MotionSamples:
        """Return the motion at times 0 … duration."""
        if self.duration <= 0.0:
            raise ValueError("a motion of zero duration has no samples")
        u = np.clip(np.asarray(t) / self.duration, 0.0, 1.0)[:, None]
        distance, rate = self.end - self.start, 1.0 / self.duration
        shape = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        first = 30.0 * u**2 * (1.0 - u) ** 2 * rate
        second = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) * rate**2
        third = 60.0 * (1.0 - 6.0 * u + 6.0 * u**2) * rate**3
        parts = (kind * distance for kind in (first, second, third))
        return MotionSamples(np.asarray(t), self.start + shape * distance, *parts)


def approach_motion(
    rest: Array,
    start: Array,
    limits: MotionRange,
    sets: Sequence[ConstraintSet],
    *,
    step: float = 1e-3,
) -> RestToRest:
    """Return a motion from the rest pose to the start of the trajectory, within all limits.

    Parameters
    ----------
    rest, start : (n,)
        Poses, rad.
    limits : MotionRange
    sets : sequence of ConstraintSet
        Verified at 400 samples.
    step : float
        The duration is a multiple of it, s, so that the last sample is at rest.

    Raises
    ------
    NoSolution
        Names the limit that the straight joint-space motion violates at every speed.
    """
    distance = np.abs(start - rest)
    if not distance.max() > 1e-9:
        return RestToRest(rest, start, 0.0)
    shortest = MARGIN * max(
        float(np.max(PEAK_VELOCITY * distance / limits.velocity)),
        float(np.max(np.sqrt(PEAK_ACCELERATION * distance / limits.acceleration))),
    )
    violated = ""
    for factor in DURATIONS:
        path = RestToRest(rest, start, float(np.ceil(factor * shortest / step)) * step)
        violated = _violated_limit(path, sets)
        if not violated:
            return path
    raise NoSolution(
        f"the motion from the rest pose to the start of the trajectory violates a limit: "
        f"{violated}; choose another start pose (--start-pose), or leave out --free-start"
    )


def _violated_limit(path: RestToRest, sets: Sequence[ConstraintSet]) -> str:
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
