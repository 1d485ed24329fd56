"""Motions within limits, and a random search among them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation.basis.trajectory import (
    MotionSamples,
    Parametrization,
    SampledBasis,
    period_grid,
)
from lieid_casadi.excitation.design_problem import FINE
from lieid_casadi.excitation.limits.constraint_sets import ConstraintSet
from lieid_casadi.excitation.limits.joint_limits import MotionRange

Array = NDArray[np.float64]
COARSE = 4  # grid on which limits are kept during the search, in samples of the criterion
ROOM = 0.998  # of each limit is used
SHRINK = 0.9
GROW, STEP, SMALLEST = 1.5, 0.3, 1e-3  # of the steps, in parts of z's own size


@dataclass(frozen=True, eq=False)
class Feasible:
    """Free variables z of motions within limits.

    Attributes
    ----------
    sets : tuple of ConstraintSet
        Beside the joint limits.
    """

    parametrization: Parametrization
    range: MotionRange
    sets: tuple[ConstraintSet, ...]
    samples: int

    def motion(self, z: Array) -> MotionSamples:
        """Return the criterion's samples of one period."""
        return self._grid(1).motion(z)

    def within(self, z: Array) -> Array:
        """Return z shrunk towards the start pose until all limits hold on the coarse grid.

        Joint limits shrink their own joint alone, exactly; the others shrink all joints.

        Raises
        ------
        NoSolution
            Not even a hundredth of the motion is within the limits.
        """
        z = self._within_joints(z)
        for _ in range(50):
            motion = self._coarse.motion(z)
            if all((s.excess(s.values(motion)).max(axis=1) <= 0.0).all() for s in self.sets):
                return z
            z = SHRINK * z
        remedies = "; ".join(s.remedy for s in self.sets)
        raise NoSolution(f"no motion about the start pose is within the limits; relax: {remedies}")

    def verified(self, z: Array) -> tuple[Array, float]:
        """Return z shrunk until the limits hold on the fine grid, and the largest violation.

        The violation is in parts of each limit's scale; negative is room.
        """
        fine = self._grid(FINE)
        for _ in range(50):
            motion = fine.motion(z)
            worst = max(
                float((s.excess(s.values(motion)).max(axis=1) / s.scale).max())
                for s in (self.range.constraint_set(), *self.sets)
            )
            if worst <= 0.0:
                return z, worst
            z = ROOM * z
        raise NoSolution("no motion about the start pose is within the limits on a fine grid")

    def drawn(self, random: np.random.Generator) -> Array:
        """Return a random motion: some joints slow, some fast, within limits."""
        n = self.parametrization.n
        z = random.standard_normal((n, self.parametrization.size // n))
        # far outside, so that the joint limits decide; then a part of what they allow
        inside = self._within_joints(np.ravel(100.0 * z)).reshape(n, -1)
        return self.within(np.ravel(inside * random.uniform(0.1, 1.0, (n, 1))))

    def _within_joints(self, z: Array) -> Array:
        motion = self._coarse.motion(z)
        pose = self.parametrization.pose
        swing = motion.q - pose
        ratios = [
            swing.max(axis=0) / (self.range.position[:, 1] - pose),
            -swing.min(axis=0) / (pose - self.range.position[:, 0]),
            np.abs(motion.dq).max(axis=0) / self.range.velocity,
            np.abs(motion.ddq).max(axis=0) / self.range.acceleration,
        ]
        worst = np.maximum(np.max(ratios, axis=0) / ROOM, 1.0)
        return np.ravel(z.reshape(len(pose), -1) / worst[:, None])

    @cached_property
    def _coarse(self) -> SampledBasis:
        return self._grid(COARSE)

    @cached_property
    def _grids(self) -> dict[int, SampledBasis]:
        return {}

    def _grid(self, factor: int) -> SampledBasis:
        if factor not in self._grids:
            times = period_grid(self.parametrization.basis.duration, factor * self.samples)
            self._grids[factor] = SampledBasis(self.parametrization, times)
        return self._grids[factor]


@dataclass(frozen=True, eq=False)
class Climb:
    """The best z that a search found, its value, and how many evaluations it took."""

    z: Array
    value: float
    evaluations: int
    interrupted: bool = False


def climb(
    value: Callable[[Array], float],
    feasible: Feasible,
    start: Array,
    *,
    evaluations: int,
    until: float,
    random: np.random.Generator,
) -> Climb:
    """Climb from a start by random steps; Ctrl-C keeps the best so far.

    A (1+1) evolution strategy with the one-fifth rule (Rechenberg 1973): a step of all joints or
    of one is kept if it is better; steps grow after a success and shrink after a failure, and
    start anew once they are small, since the worst pair of several makes ridges on which they
    shrink. ``until`` is a time of `time.monotonic`. The optimum found is local.
    """
    n = feasible.parametrization.n
    best, highest, step = start, -np.inf, STEP
    used = 0
    try:
        highest = value(start)
        used = 1
        while used < evaluations and time.monotonic() < until:
            move = random.standard_normal((n, len(best) // n))
            if n > 1 and random.random() < 0.5:
                only = np.zeros((n, 1))
                only[random.integers(n)] = 1.0
                move = move * only
            size = np.sqrt(np.mean(best**2))
            z = feasible.within(best + step * size * np.ravel(move))
            reached = value(z)
            used += 1
            if reached > highest:
                best, highest, step = z, reached, min(step * GROW, 1.0)
            else:
                step = step * GROW**-0.25 if step > SMALLEST else STEP
    except KeyboardInterrupt:
        return Climb(best, highest, used, interrupted=True)
    return Climb(best, highest, used)


def best_starts(values: Sequence[float], count: int) -> list[int]:
    """Return the indices of the largest values, largest first."""
    return [int(k) for k in np.argsort(values)[::-1][:count]]
