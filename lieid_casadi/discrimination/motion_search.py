"""Motions within limits, and the search for the best of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from lieid_casadi.arrays import Array
from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation.design import excesses_along, rest_pose
from lieid_casadi.excitation.limits import (
    ConstraintSet,
    JointLimits,
    Limit,
    LimitOnArm,
    MotionRange,
    check_duration,
    on_arm,
    sets_of,
)
from lieid_casadi.excitation.sample_functions import FittedArm
from lieid_casadi.excitation.trajectory import (
    Fourier,
    MotionSamples,
    Parametrization,
    SampledBasis,
    period_grid,
)
from lieid_casadi.identification import Fit
from lieid_casadi.robot import Robot

MEMORY = 500  # samples of the noise
SAMPLES = 200  # fewest of the criterion over a period; 8 per coefficient if that is more
COARSE = 4  # points per sample of the criterion, on which limits are checked during the search
USED = 0.998  # part of each limit that is used
SHRINK = 0.9  # factor by which a motion outside of the limits is reduced
GROWTH = 1.5  # of the step after a success
INITIAL_STEP, SMALLEST_STEP = 0.3, 1e-3  # relative to the RMS of z


@dataclass(frozen=True, eq=False)
class FeasibleMotions:
    """Motions within joint limits and further ones, as vectors z of free coefficients."""

    parametrization: Parametrization
    range: MotionRange
    sets: tuple[ConstraintSet, ...]
    limits: tuple[LimitOnArm, ...]
    samples: int

    def motion(self, z: Array) -> MotionSamples:
        """Return the samples of the criterion over one period."""
        return self._sampled.motion(z)

    def within(self, z: Array) -> Array:
        """Return z shrunk towards the start pose until all limits hold on the coarse grid.

        Joint limits shrink their own joint alone, exactly; the others shrink all joints.
        """
        z = self._within_joints(z)
        for _ in range(50):
            motion = self._coarse.motion(z)
            if all((s.excess(s.values(motion)).max(axis=1) <= 0.0).all() for s in self.sets):
                return z
            z = SHRINK * z
        remedies = "; ".join(s.remedy for s in self.sets)
        raise NoSolution(f"no motion around the start pose is within the limits; relax: {remedies}")

    def verified(self, z: Array) -> tuple[Array, float]:
        """Return z shrunk until the limits hold on the fine grid, and the largest violation.

        The violation is relative to the scale of each limit; negative values are margins.
        """
        sets = (JointLimits(self.range), *self.sets)
        for _ in range(50):
            trajectory = self.parametrization.trajectory(z)
            worst = max(x.scaled for x in excesses_along(trajectory, sets, self.samples))
            if worst <= 0.0:
                return z, worst
            z = USED * z
        raise NoSolution(
            "no motion around the start pose is within the limits on a fine grid; "
            "choose another start pose"
        )

    def drawn(self, random: np.random.Generator) -> Array:
        """Return a random motion within limits, with a random amplitude for each joint."""
        n = self.parametrization.n
        z = random.standard_normal((n, self.parametrization.size // n))
        # far outside, so that the joint limits determine the amplitude; then a part of it
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
        worst = np.maximum(np.max(ratios, axis=0) / USED, 1.0)
        return np.ravel(z.reshape(len(pose), -1) / worst[:, None])

    @cached_property
    def _sampled(self) -> SampledBasis:
        return self._grid(self.samples)

    @cached_property
    def _coarse(self) -> SampledBasis:
        return self._grid(COARSE * self.samples)

    def _grid(self, samples: int) -> SampledBasis:
        p = self.parametrization
        return SampledBasis(p, period_grid(p.basis.duration, samples))


def feasible_motions(
    robot: Robot,
    fit: FittedArm | None,
    joints: MotionRange,
    limits: Sequence[Limit],
    *,
    duration: float,
    harmonics: int,
    start_pose: ArrayLike | None,
) -> FeasibleMotions:
    """Return the motions of a Fourier basis within limits; they start and end at rest."""
    basis = Fourier(harmonics, duration)
    check_duration(robot, joints, duration)
    made = on_arm(limits, robot, fit)
    sets = sets_of(made)
    every = (JointLimits(joints), *sets)
    pose = rest_pose(robot, joints, every, start_pose)
    parametrization = Parametrization(basis, pose, joints.units)
    return FeasibleMotions(parametrization, joints, sets, made, max(SAMPLES, 8 * basis.size))


@dataclass(frozen=True, eq=False)
class SearchedMotion:
    """The best motion (m,) that a search found, and its value of the criterion."""

    z: Array
    value: float
    evaluations: int
    interrupted: bool = False


def random_search(
    criterion: Callable[[Array], float],
    feasible: FeasibleMotions,
    start: Array,
    *,
    evaluations: int,
    random: np.random.Generator,
) -> SearchedMotion:
    """Improve a motion by random steps; Ctrl-C keeps the best motion so far.

    A (1+1) evolution strategy with the one-fifth rule (Rechenberg 1973). A step of all joints or
    of one joint is kept if the criterion increases. Steps grow after a success and shrink after a
    failure. They are reset once they are small, since a criterion that is the minimum over
    several pairs has ridges, on which steps shrink without convergence. The optimum is local.
    """
    n = feasible.parametrization.n
    best, highest, step = start, -np.inf, INITIAL_STEP
    used = 0
    try:
        highest = criterion(start)
        used = 1
        while used < evaluations:
            move = random.standard_normal((n, len(best) // n))
            if n > 1 and random.random() < 0.5:
                only = np.zeros((n, 1))
                only[random.integers(n)] = 1.0
                move = move * only
            size = np.sqrt(np.mean(best**2))
            z = feasible.within(best + step * size * np.ravel(move))
            reached = criterion(z)
            used += 1
            if reached > highest:
                best, highest, step = z, reached, min(step * GROWTH, 1.0)
            else:
                step = step * GROWTH**-0.25 if step > SMALLEST_STEP else INITIAL_STEP
    except KeyboardInterrupt:
        return SearchedMotion(best, highest, used, interrupted=True)
    return SearchedMotion(best, highest, used)


def independent_rate(fit: Fit) -> Array:
    """Return the independent samples per second of each joint's residual (n,).

    Its samples are at twice the cut-off frequency of the fit's filter. With the autocorrelations
    ρ_k of the noise, 1 + 2·Σρ_k of them have as much information on slow torques as an independent
    one; that is (Σh)²/Σh² with the impulse response h of the noise.
    """
    cutoff = fit.processing.cutoff
    assert cutoff is not None
    responses = [lfilter([1.0], noise.filter, np.eye(1, MEMORY)[0]) for noise in fit.residual_noise]
    correlated = [max(1.0, float(h.sum() ** 2 / (h @ h))) for h in responses]
    return 2.0 * cutoff / np.array(correlated)
