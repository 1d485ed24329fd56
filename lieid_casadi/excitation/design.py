"""A design problem: its specification from the arguments of ``excite``, and its functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import require_regular
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation.checks import MARGIN, default_limits
from lieid_casadi.excitation.criteria import (
    NAMES,
    Criterion,
    CriterionExpression,
    CriterionName,
    LogDet,
    ObjectiveValue,
    ScalingName,
    column_scale,
    criterion_name,
    unit_norm_gram,
)
from lieid_casadi.excitation.information import InformationMatrix, design_model
from lieid_casadi.excitation.limits import (
    ConstraintSet,
    Limit,
    MotionRange,
    SampledConstraints,
    check_duration,
    check_start_pose,
    motion_range,
    sets_of,
)
from lieid_casadi.excitation.sample_functions import FittedArm, IdentifiedModel, model_and_fit
from lieid_casadi.excitation.trajectory import (
    Basis,
    MotionSamples,
    Parametrization,
    SampledBasis,
    check_basis,
    period_grid,
)
from lieid_casadi.model import Model
from lieid_casadi.robot import Robot

TRIED = 2000  # random poses
RANGE_USED = 0.9  # part of the joint ranges that a motion around the pose uses
RANGE_TRIED = 0.6  # part of the joint ranges around their middle
ENOUGH = 0.05  # scaled distance from every limit above which the middle of the ranges is taken


def check_at_rest(pose: Array, sets: Sequence[ConstraintSet]) -> None:
    """Refuse a start pose (n,) that violates a limit at rest.

    Raises
    ------
    NoSolution
        Names the limit.
    """
    excess, names = _excess(pose[None], sets)
    worst = int(np.argmax(excess[:, 0]))
    if excess[worst, 0] > 0.0:
        raise NoSolution(
            f"the start pose violates a limit at rest: {names[worst]}; choose another start pose "
            "(--start-pose) or relax the limit"
        )


def find_start_pose(
    limits: MotionRange, sets: Sequence[ConstraintSet], *, travel: Array | None = None
) -> Array:
    """Return the middle of the joint ranges or, near a limit, the random pose farthest from all.

    Parameters
    ----------
    limits : MotionRange
    sets : sequence of ConstraintSet
        Evaluated at rest.
    travel : (n,), optional
        Distance that each joint will move to either side of the pose, rad.

    Raises
    ------
    NoSolution
        No pose meets all limits; names the one that the best pose violates.
    """
    half = RANGE_TRIED * limits.units[:, 0]
    if travel is not None:
        space = np.maximum(limits.units[:, 0] - travel / RANGE_USED, 0.0)
        half = np.where(travel > 0.0, space, half)
    random = np.random.default_rng(0).uniform(-half, half, (TRIED, len(half)))
    poses = limits.middle + np.vstack([np.zeros(len(half)), random])
    excess, names = _excess(poses, sets)
    if travel is not None:
        for part in (-1.0, -0.5, 0.5, 1.0):
            excess = np.maximum(excess, _excess(poses + part * travel, sets)[0])
    largest = excess.max(axis=0)
    best = 0 if largest[0] <= -ENOUGH else int(np.argmin(largest))
    if largest[best] > 0.0:
        raise NoSolution(
            f"no start pose of {TRIED} meets all limits: {names[int(np.argmax(excess[:, best]))]} "
            "is violated; relax it, or give a start pose (--start-pose)"
        )
    return np.asarray(poses[best])


def _excess(poses: Array, sets: Sequence[ConstraintSet]) -> tuple[Array, list[str]]:
    """Return scaled excesses (k, N) at rest in poses (N, n), and the names of the quantities."""
    rest = np.zeros_like(poses)
    motion = MotionSamples(np.zeros(len(poses)), poses, rest, rest, rest)
    parts = [s.excess(s.values(motion)) / s.scale[:, None] for s in sets]
    return np.concatenate(parts), [label for s in sets for label in s.labels]


SIGN_WIDTH = 0.02  # width of the smooth sign, in parts of the velocity limit
DISTANCE = 1e-3  # distance from a limit during the optimization, in parts of its scale
COARSE = 4  # grid points of the optimization per sample of the criterion
FINE = 20  # grid points of the verification per sample of the criterion
FAR = 0.3  # distance of −log det per parameter from Δ₂ above which its gradient is omitted


@dataclass(frozen=True, eq=False)
class ExcitationDesign:
    """Specification of a design; picklable, so that another process can solve it.

    Attributes
    ----------
    model : Model
        Its regressor is the one that the criterion evaluates.
    fit : FittedArm or None
        Identified parameters; without them the stated inertias and initial shapes are used.
    basis : Basis
    samples : int
        Of the criterion, over one period.
    range : MotionRange
        Joint limits.
    limits : tuple of Limit
        Limits besides the joint limits.
    pose : (n,) or None
        Start pose; where the trajectory may start anywhere (``fixed`` False), its middle. Rad.
        None: found within all limits.
    fixed : bool
        Whether the trajectory starts and ends at ``pose``.
    criterion : str or callable
        Name, or expression of G.
    column_scale : (P,) or None
        Factors of the full regressor's columns, ones for plain SI; None: columns of the base
        regressor, scaled to unit norm.
    condition_threshold, neg_log_det_threshold : float, optional
        Δ₁ and Δ₂ of the criterion ``combined`` (Eq. 20).
    start : (N, n), optional
        Positions over one period, equidistant in time, from which the first search starts; rad.
    """

    model: Model
    fit: FittedArm | None
    basis: Basis
    samples: int
    range: MotionRange
    limits: tuple[Limit, ...]
    pose: Array | None
    fixed: bool
    criterion: CriterionName | CriterionExpression
    column_scale: Array | None
    condition_threshold: float | None = None
    neg_log_det_threshold: float | None = None
    start: Array | None = None


class ExcitationProblem:
    """A design with the compiled functions that its solution needs."""

    def __init__(self, design: ExcitationDesign) -> None:
        self.design = design
        sets, self.left_out = sets_of(design.limits, design.model.robot, design.fit)
        self.sets = (design.range.constraint_set(), *sets)
        self.pose = self._start_pose()
        self.parametrization = Parametrization(
            design.basis, self.pose, design.fixed, design.range.units
        )
        self.information = InformationMatrix(
            design.model, sign_width=SIGN_WIDTH * design.range.velocity, fit=design.fit
        )

    def _start_pose(self) -> Array:
        if self.design.pose is None:
            return find_start_pose(self.design.range, self.sets)
        check_at_rest(self.design.pose, self.sets)
        return self.design.pose

    @cached_property
    def metric(self) -> Array:
        """L (p, p): LᵀGL has the nonzero eigenvalues of the full scaled regressor's Gram matrix.

        The identity for base columns of unit norm.
        """
        if self.design.column_scale is None:
            return np.eye(self.design.model.base.count)
        scaled = self.design.model.base.combination * self.design.column_scale
        return np.asarray(np.linalg.cholesky(scaled @ scaled.T))

    @cached_property
    def samples(self) -> SampledBasis:
        """Grid of the criterion."""
        times = period_grid(self.design.basis.duration, self.design.samples)
        return SampledBasis(self.parametrization, times)

    def constraints(self, factor: int, *, margin: float = DISTANCE) -> SampledConstraints:
        """Return the constraint sets on a grid ``factor`` times finer, with the period's end."""
        duration = self.design.basis.duration
        times = np.append(period_grid(duration, factor * self.design.samples), duration)
        return SampledConstraints(
            self.sets, SampledBasis(self.parametrization, times), margin=margin
        )

    def gram(self, z: Array) -> Array:
        """Return G (p, p) of the base regressor at z."""
        return self.information.at(self.samples.motion(z)).gram()

    def condition_number(self, gram: Array) -> float:
        """Return the condition number of the scaled regressor with G (p, p)."""
        scaled = gram if self.design.column_scale is not None else unit_norm_gram(gram)
        return condition_number(scaled, self.metric)

    def objective(self, criterion: Criterion, ceiling: float | None = None) -> ExcitationObjective:
        """Return f(z) of a criterion, with −log det G / p ≤ ceiling where one is given."""
        return ExcitationObjective(self, criterion, ceiling)


@dataclass(frozen=True, eq=False)
class ExcitationObjective:
    """A criterion as a function of z."""

    problem: ExcitationProblem
    criterion: Criterion
    ceiling: float | None

    def __call__(self, z: Array) -> ObjectiveValue:
        """Return value, gradient and −log det above its ceiling at free variables (m,)."""
        p = self.problem
        stacked = p.information.at(p.samples.motion(z))
        gram = stacked.gram()

        def in_variables(slope: Array) -> Array:
            return p.samples.gradient(p.information.gradient(stacked, slope))

        value, slope = self.criterion.evaluate(gram)
        excess, slopes = np.zeros(0), np.zeros((0, len(z)))
        if self.ceiling is not None:
            volume, volume_slope = LogDet().evaluate(gram)
            excess, slopes = np.array([volume - self.ceiling]), np.zeros((1, len(z)))
            if excess[0] > -FAR:  # farther away no step reaches the ceiling
                slopes[0] = in_variables(volume_slope)
        return ObjectiveValue(value, in_variables(slope), gram, excess, slopes)


def condition_number(gram: Array, metric: Array) -> float:
    """Return σ₁/σ_r from G; for condition numbers below 1e6."""
    sizes = np.linalg.eigvalsh(metric.T @ gram @ metric)
    return float(np.sqrt(sizes[-1] / max(sizes[0], 1e-300)))


MOST_SAMPLES = 100_000  # of one period in the criterion


def make_design(
    source: Model | Robot | IdentifiedModel,
    *,
    basis: Basis,
    criterion: CriterionName | CriterionExpression = "combined",
    inertial_only: bool = False,
    limits: Sequence[Limit] | None = None,
    start_pose: ArrayLike | None = None,
    free_start: bool = False,
    acceleration: ArrayLike | None = None,
    margin: float = MARGIN,
    samples: int = 100,
    scaling: ScalingName | Sequence[float] | Array = "si",
    condition_threshold: float | None = None,
    neg_log_det_threshold: float | None = None,
    start: str | Path | None = None,
) -> ExcitationDesign:
    """Check the arguments of `excite` and return the design that they specify.

    Parameters
    ----------
    source : Model, Robot or Fit
    basis : Basis
    criterion, inertial_only, limits, start_pose, free_start, acceleration, samples, scaling, start
        As in `excite`.
    condition_threshold, neg_log_det_threshold : float, optional
        Δ₁ and Δ₂ of the criterion ``combined``.

    Raises
    ------
    ExcitationError
    """
    if not callable(criterion) and criterion not in NAMES:
        raise ExcitationError(
            f"criterion: {criterion!r}; expected one of {', '.join(NAMES)}, or a function of the "
            "information matrix"
        )
    check_basis(basis)
    if not 4 * basis.size <= samples <= MOST_SAMPLES:
        raise ExcitationError(
            f"samples: {samples}; expected {4 * basis.size} at least for {basis.size} "
            f"coefficients per joint, and at most {MOST_SAMPLES}"
        )
    check_thresholds(criterion, condition_threshold, neg_log_det_threshold)
    model, fit = model_and_fit(source)
    reduced = Model(model.robot) if inertial_only else design_model(model)[0]
    robot = reduced.robot
    joints = motion_range(robot, acceleration, margin=margin)
    check_duration(robot, joints, basis.duration)
    first = None if start is None else load_positions(start, robot.n)
    if start_pose is None and first is not None:
        start_pose = first[0]
    pose = None if start_pose is None else np.asarray(start_pose, dtype=float)
    if pose is not None:
        check_start_pose(robot, joints, pose)
    if limits is None:
        limits = default_limits(robot, margin=margin)
    return ExcitationDesign(
        reduced, fit, basis, samples, joints, tuple(limits), pose, not free_start, criterion,
        column_scale(reduced, scaling), condition_threshold, neg_log_det_threshold, first,
    )  # fmt: skip


def check_thresholds(
    criterion: CriterionName | CriterionExpression,
    condition_threshold: float | None,
    neg_log_det_threshold: float | None,
) -> None:
    """Refuse thresholds that the criterion does not have.

    Parameters
    ----------
    criterion : str or callable
    condition_threshold, neg_log_det_threshold : float or None
        Δ₁ and Δ₂.

    Raises
    ------
    ExcitationError
    """
    given = {
        "condition_threshold": condition_threshold, "neg_log_det_threshold": neg_log_det_threshold,
    }  # fmt: skip
    for name, value in given.items():
        if value is not None and criterion != "combined":
            raise ExcitationError(
                f"{name}: only the criterion 'combined' has it, not {criterion_name(criterion)!r}"
            )
    if condition_threshold is not None and not condition_threshold >= 1.0:
        raise ExcitationError(f"condition_threshold: {condition_threshold:g}; expected at least 1")


USED = 0.9  # part of a joint limit that every joint of a start uses
LARGE_EXCESS = 0.3  # scaled excess above which a start is made smaller
SHRINK = 0.75
SHRINK_ROUNDS = 6


def random_start(problem: ExcitationProblem, seed: int) -> Array:
    """Return free variables (m,) that use 90 % of some joint limit of every joint.

    Where that violates other limits by much, all joints move less.
    """
    parametrization = problem.parametrization
    generator = np.random.default_rng(seed)
    z = generator.normal(size=(parametrization.n, parametrization.directions_per_joint))
    motion = problem.samples.motion(z.ravel())
    units, position = problem.design.range.units, problem.design.range.position
    from_pose = np.abs(motion.q - parametrization.pose)
    reach = np.minimum(position[:, 1] - parametrization.pose, parametrization.pose - position[:, 0])
    reach = np.where(np.isfinite(reach), reach, units[:, 0])
    used = np.stack(
        [
            from_pose.max(axis=0) / reach,
            np.abs(motion.dq).max(axis=0) / units[:, 1],
            np.abs(motion.ddq).max(axis=0) / units[:, 2],
        ]
    ).max(axis=0)
    start = np.ravel(USED * z / used[:, None])
    constraints = problem.constraints(1)
    for _ in range(SHRINK_ROUNDS):
        excess = constraints.excess(constraints.sampled.motion(start))
        if constraints.largest(excess) <= LARGE_EXCESS:
            break
        start = SHRINK * start
    return start


def load_positions(path: str | Path, n: int) -> Array:
    """Return the positions (N, n) of a trajectory file, equidistant in time.

    Parameters
    ----------
    path : str or Path
        CSV with the columns t, q1 … qn, as ``trajectory.csv``; lines with # precede the header.
    n : int
        Number of joints.

    Raises
    ------
    ExcitationError
        Not such a file; names what is missing.
    """
    try:
        require_regular(path)
        lines = Path(path).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ExcitationError(f"start: {path} cannot be read: {error}") from None
    rows = [line for line in lines if line.strip() and not line.startswith("#")]
    header = rows[0].split(",") if rows else []
    names = ["t", *(f"q{j + 1}" for j in range(n))]
    missing = [name for name in names if name not in header]
    if missing:
        raise ExcitationError(f"start: {path} has no column {missing[0]}; expected t, q1 … q{n}")
    try:
        columns = [header.index(name) for name in names]
        table = np.loadtxt(rows[1:], delimiter=",", usecols=columns, ndmin=2)
    except ValueError as error:
        raise ExcitationError(f"start: {path}: {error}") from None
    t = table[:, 0]
    if len(t) < 3 or not np.isfinite(table).all() or not np.all(np.diff(t) > 0.0):
        raise ExcitationError(
            f"start: {path}: expected 3 rows of finite numbers at least, with increasing times"
        )
    grid = np.linspace(t[0], t[-1], len(t))
    return np.column_stack([np.interp(grid, t, q) for q in table[:, 1:].T])


def warm_start(parametrization: Parametrization, positions: Array) -> Array:
    """Return the free variables (m,) of the trajectory nearest to positions (N, n), equidistant.

    The positions are taken as one period: their time is scaled to the period of the basis.
    """
    t = np.linspace(0.0, parametrization.basis.duration, len(positions))
    functions = parametrization.functions(t)[:, 0]  # (n, N, d)
    moved = positions - parametrization.pose
    return np.concatenate(
        [np.linalg.lstsq(f, q, rcond=None)[0] for f, q in zip(functions, moved.T, strict=True)]
    )
