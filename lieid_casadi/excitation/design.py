"""A design problem: its limits, start pose and functions, from the arguments of ``excite``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation import criteria
from lieid_casadi.excitation.checks import CONTROL_STEP, MARGIN, SINGULAR, default_limits
from lieid_casadi.excitation.ipopt import Objective, ObjectiveValue, SampledConstraints
from lieid_casadi.excitation.limits import (
    ConstraintSet,
    JointLimits,
    Limit,
    MotionRange,
    check_duration,
    joint_name,
    motion_range,
    on_arm,
    sets_of,
)
from lieid_casadi.excitation.rigid_arm import nearness_to_singular
from lieid_casadi.excitation.sample_functions import IdentifiedModel, model_and_fit
from lieid_casadi.excitation.trajectory import (
    Fourier,
    MotionSamples,
    Parametrization,
    SampledBasis,
    Trajectory,
    period_grid,
)
from lieid_casadi.model import Model
from lieid_casadi.robot import Robot

MOST_SAMPLES = 100_000  # of one period in the criterion
TRIED = 2000  # random poses
RANGE_USED = 0.9  # part of the joint ranges that a motion around the pose uses
RANGE_TRIED = 0.6  # part of the joint ranges around their middle
ENOUGH = 0.05  # scaled distance from every limit above which the middle of the ranges is taken
SIGN_WIDTH = 0.02  # width of the smooth sign, in parts of the velocity limit
DISTANCE = 1e-3  # distance from a limit during the optimization, in parts of its scale
COARSE = 4  # grid points of the optimization per sample of the criterion
FINE = 20  # grid points of the verification per sample of the criterion, at least
FAR = 0.3  # distance of −log det per parameter from Δ₂ above which its gradient is omitted


@dataclass(frozen=True, eq=False)
class Excess:
    """Largest excess of a quantity over its limit (negative inside), and when, s."""

    label: str
    unit: str
    value: float
    scaled: float  # in parts of the limit's scale
    time: float
    remedy: str


def excesses_along(
    trajectory: Trajectory, sets: Sequence[ConstraintSet], samples: int
) -> list[Excess]:
    """Return the excess of every quantity on a grid 20 times finer than the samples, or 1 kHz."""
    count = FINE * samples
    count *= int(np.ceil(trajectory.duration / CONTROL_STEP / count))
    times = np.append(period_grid(trajectory.duration, count), trajectory.duration)
    motion = trajectory.at(times)
    return [
        Excess(label, unit, float(value), float(value / scale), float(t), made.remedy)
        for made in sets
        for label, unit, scale, value, t in zip(
            made.labels, made.units, made.scale, *made.largest_excess(motion), strict=True
        )
    ]


class ExcitationProblem:
    """A design with the compiled functions that its solution needs; arguments as of `excite`.

    ``limits`` are those besides the joints'. ``condition_threshold`` is Δ₁ of the criterion
    ``combined`` (Eq. 20), at which a search ends, ``neg_log_det_threshold`` Δ₂, its bound on −log
    det; by default the condition number is minimized, and Δ₂ follows from the first stage.
    """

    def __init__(
        self,
        source: Model | Robot | IdentifiedModel,
        *,
        basis: Fourier,
        criterion: criteria.CriterionName
        | criteria.CriterionExpression
        | criteria.Criterion = "combined",
        inertial_only: bool = False,
        limits: Sequence[Limit] | None = None,
        start_pose: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        margin: float = MARGIN,
        samples: int = 100,
        condition_threshold: float | None = None,
        neg_log_det_threshold: float | None = None,
    ) -> None:
        if isinstance(criterion, str) and criterion not in criteria.NAMES:
            raise ExcitationError(
                f"criterion: {criterion!r}; expected one of {', '.join(criteria.NAMES)}, or a "
                "function of the information matrix"
            )
        if not 4 * basis.size <= samples <= MOST_SAMPLES:
            raise ExcitationError(
                f"samples: {samples}; expected {4 * basis.size} at least for {basis.size} "
                f"coefficients per joint, and at most {MOST_SAMPLES}"
            )
        model, self.fit = model_and_fit(source)
        self.model = Model(model.robot) if inertial_only else criteria.design_model(model)[0]
        robot = self.model.robot
        self.basis, self.criterion, self.sample_count = basis, criterion, samples
        self.condition_threshold = condition_threshold
        self.neg_log_det_threshold = neg_log_det_threshold
        self.range = motion_range(robot, acceleration, margin=margin)
        check_duration(robot, self.range, basis.duration)
        if limits is None:
            limits = default_limits(robot, margin=margin)
        self.limits = on_arm(limits, robot, self.fit)
        self.sets = (JointLimits(self.range), *sets_of(self.limits))
        self.pose = rest_pose(robot, self.range, self.sets, start_pose)
        self.parametrization = Parametrization(basis, self.pose, self.range.units)
        self.information = criteria.InformationMatrix(
            self.model, sign_width=SIGN_WIDTH * self.range.velocity, fit=self.fit
        )

    @cached_property
    def metric(self) -> Array:
        """L (p, p): LᵀGL has the nonzero eigenvalues of the full regressor's Gram matrix."""
        base = self.model.base
        return np.asarray(np.linalg.cholesky(base.combination @ base.combination.T))

    @cached_property
    def stages(self) -> tuple[criteria.CriterionStage, ...]:
        """Stages of the search."""
        return criteria.stages(self.criterion, self.metric)

    @cached_property
    def samples(self) -> SampledBasis:
        """Grid of the criterion."""
        times = period_grid(self.basis.duration, self.sample_count)
        return SampledBasis(self.parametrization, times)

    def constraints(self, factor: int, *, margin: float = DISTANCE) -> SampledConstraints:
        """Return the constraint sets on a grid ``factor`` times finer, with the period's end."""
        duration = self.basis.duration
        times = np.append(period_grid(duration, factor * self.sample_count), duration)
        return SampledConstraints(
            self.sets, SampledBasis(self.parametrization, times), margin=margin
        )

    def excesses(self, z: Array) -> list[Excess]:
        """Return the excess of every quantity at z, on the fine grid."""
        return excesses_along(self.parametrization.trajectory(z), self.sets, self.sample_count)

    def within_limits(self, z: Array) -> bool:
        """Return whether the motion keeps every limit on the fine grid."""
        return all(excess.value <= 0.0 for excess in self.excesses(z))

    def gram(self, z: Array) -> Array:
        """Return G (p, p) of the base regressor at z."""
        rows = self.information.rows(self.samples.motion(z))
        return np.asarray(rows @ rows.T)

    def condition_number(self, gram: Array) -> float:
        """Return σ₁/σ_r of the regressor with G (p, p); for condition numbers below 1e6."""
        sizes = np.linalg.eigvalsh(self.metric.T @ gram @ self.metric)
        return float(np.sqrt(sizes[-1] / max(sizes[0], 1e-300)))

    def objective(self, criterion: criteria.Criterion, ceiling: float | None = None) -> Objective:
        """Return f(z) of a criterion, with −log det G / p ≤ ceiling where one is given."""

        def at(z: Array) -> ObjectiveValue:
            motion = self.samples.motion(z)
            rows = self.information.rows(motion)
            gram = rows @ rows.T

            def in_variables(slope: Array) -> Array:
                return self.samples.gradient(self.information.gradient(motion, rows, slope))

            value, slope = criterion.evaluate(gram)
            excess, slopes = np.zeros(0), np.zeros((0, len(z)))
            if ceiling is not None:
                volume, volume_slope = criteria.LogDet().evaluate(gram)
                excess, slopes = np.array([volume - ceiling]), np.zeros((1, len(z)))
                if excess[0] > -FAR:  # farther away no step reaches the ceiling
                    slopes[0] = in_variables(volume_slope)
            return ObjectiveValue(value, in_variables(slope), gram, excess, slopes)

        return at

    def random_start(self, seed: int) -> Array:
        """Return free variables (m,) that use 90 % of some joint limit of every joint.

        Where that violates other limits by more than 0.3 of their scale, all joints move less.
        """
        parametrization, limits = self.parametrization, self.range
        generator = np.random.default_rng(seed)
        z = generator.normal(size=(parametrization.n, parametrization.directions_per_joint))
        motion = self.samples.motion(z.ravel())
        units, position = limits.units, limits.position
        reach = np.minimum(position[:, 1] - self.pose, self.pose - position[:, 0])
        reach = np.where(np.isfinite(reach), reach, units[:, 0])
        used = np.stack(
            [
                np.abs(motion.q - self.pose).max(axis=0) / reach,
                np.abs(motion.dq).max(axis=0) / units[:, 1],
                np.abs(motion.ddq).max(axis=0) / units[:, 2],
            ]
        ).max(axis=0)
        start = np.ravel(0.9 * z / used[:, None])
        constraints = self.constraints(1)
        for _ in range(6):
            if constraints.excess(constraints.sampled.motion(start)).max() <= 0.3:
                break
            start = 0.75 * start
        return start


def rest_pose(
    robot: Robot, limits: MotionRange, sets: Sequence[ConstraintSet], given: ArrayLike | None
) -> Array:
    """Return the pose (n,) at which a motion starts and ends: one that is found, or a given one."""
    if given is None:
        return find_start_pose(robot, limits, sets)
    pose = np.asarray(given, dtype=float)
    if pose.shape != (robot.n,) or not np.all(np.isfinite(pose)):
        raise ExcitationError(f"start pose: {pose.size} numbers; expected {robot.n}, one per joint")
    for j, (low, high) in enumerate(limits.position):
        if not low < pose[j] < high:
            raise ExcitationError(
                f"start pose: {joint_name(robot, j)} at {pose[j]:g}, outside its position limits "
                f"{low:g} … {high:g}"
            )
    excess, names = _excess_at_rest(pose[None], sets)
    worst = int(np.argmax(excess[:, 0]))
    if excess[worst, 0] > 0.0:
        raise NoSolution(
            f"the start pose violates a limit at rest: {names[worst]}; choose another start pose "
            "(--start-pose) or relax the limit"
        )
    return pose


def find_start_pose(
    robot: Robot, limits: MotionRange, sets: Sequence[ConstraintSet], *, travel: Array | None = None
) -> Array:
    """Return the middle of the joint ranges or, near a limit, the random pose farthest from all.

    Poses near a singular one are passed over; where all are, the one farthest from it is taken.
    ``travel`` (n,) is the distance that each joint will move to either side, rad.
    """
    half = RANGE_TRIED * limits.units[:, 0]
    if travel is not None:
        space = np.maximum(limits.units[:, 0] - travel / RANGE_USED, 0.0)
        half = np.where(travel > 0.0, space, half)
    random = np.random.default_rng(0).uniform(-half, half, (TRIED, len(half)))
    poses = limits.middle + np.vstack([np.zeros(len(half)), random])
    excess, names = _excess_at_rest(poses, sets)
    if travel is not None:
        for part in (-1.0, -0.5, 0.5, 1.0):
            excess = np.maximum(excess, _excess_at_rest(poses + part * travel, sets)[0])
    largest = excess.max(axis=0)
    order = np.argsort(largest, kind="stable")
    if largest[0] <= -ENOUGH:
        order = np.append(0, order[order != 0])
    if largest[order[0]] > 0.0:
        best = order[0]
        raise NoSolution(
            f"no start pose of {TRIED} meets all limits: {names[int(np.argmax(excess[:, best]))]} "
            "is violated; relax it, or give a start pose (--start-pose)"
        )
    inside = order[largest[order] <= 0.0]
    away = nearness_to_singular(robot, poses[inside])
    return np.asarray(poses[inside[int(np.argmax(np.minimum(away, SINGULAR)))]])


def _excess_at_rest(poses: Array, sets: Sequence[ConstraintSet]) -> tuple[Array, list[str]]:
    """Return scaled excesses (k, N) at rest in poses (N, n), and the names of the quantities."""
    rest = np.zeros_like(poses)
    motion = MotionSamples(np.zeros(len(poses)), poses, rest, rest)
    parts = [s.excess(s.values(motion)) / s.scale[:, None] for s in sets]
    return np.concatenate(parts), [label for s in sets for label in s.labels]
