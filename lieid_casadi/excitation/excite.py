"""``excite``: design of an optimal excitation trajectory for a model."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation.approach_motion import RestToRest, approach_motion
from lieid_casadi.excitation.basis import families
from lieid_casadi.excitation.basis.families import Basis, BasisName
from lieid_casadi.excitation.basis.trajectory import period_grid
from lieid_casadi.excitation.criteria.column_scaling import ScalingName
from lieid_casadi.excitation.criteria.criterion import (
    CriterionExpression,
    CriterionName,
    criterion_name,
)
from lieid_casadi.excitation.criteria.design_model import design_model
from lieid_casadi.excitation.criteria.quality import quality
from lieid_casadi.excitation.design_problem import FINE, ExcitationProblem
from lieid_casadi.excitation.excitation import ActiveLimit, Excitation, StartSummary, active_limits
from lieid_casadi.excitation.fitted_arm import IdentifiedModel, model_and_fit
from lieid_casadi.excitation.limits.default_limits import (
    MARGIN,
    checked_limits,
    unchecked_limits,
)
from lieid_casadi.excitation.limits.symbolic_limits import Limit
from lieid_casadi.excitation.make_design import make_design
from lieid_casadi.excitation.solvers.multi_start import StartAttempt, solve_all
from lieid_casadi.excitation.solvers.staged_solve import WARM_START, OptimizedStart
from lieid_casadi.model import Model
from lieid_casadi.robot import Robot

Array = NDArray[np.float64]

MOST_ROWS = 10_000_000  # of a trajectory file


@blas_on_one_thread
def excite(
    source: Model | Robot | IdentifiedModel,
    *,
    criterion: CriterionName | CriterionExpression = "combined",
    inertial_only: bool = False,
    limits: Sequence[Limit] | None = None,
    start_pose: ArrayLike | None = None,
    free_start: bool = False,
    acceleration: ArrayLike | None = None,
    margin: float = MARGIN,
    basis: BasisName | Basis = "fourier",
    duration: float = 20.0,
    harmonics: int = 5,
    periods: int = 1,
    samples: int = 100,
    rate: float = 1000.0,
    scaling: ScalingName | Sequence[float] | Array = "si",
    condition_threshold: float | None = None,
    neg_log_det_threshold: float | None = None,
    start: str | Path | None = None,
    starts: int = 4,
    seed: int = 0,
    max_iterations: int | None = None,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
    executor: Executor | None = None,
) -> Excitation:
    """Design an optimal excitation trajectory within limits.

    By default joint limits, torque, tool speed, a floor at the base plane and self-collision are
    checked. `Excitation.checked` and `Excitation.unchecked` list what is and what is not.

    The torque limit of a fit is that of the identified links with all effects, plus or minus two
    standard deviations; that of a model without a fit is the rigid torque of the stated inertias
    with an allowance for friction (see `Torque`).

    The criterion evaluates the model's own regressor, effects included, as far as its columns
    follow from the motion and the time; warnings name the effects that do not (temperature,
    memory, effects on the whole arm).

    Parameters
    ----------
    source : Model, Robot or Fit
    criterion : str or callable
        ``combined`` (the paper's C1: condition number with a bound on −log det), ``condition``
        (C2), ``hadamard`` (C3), ``logdet`` (C4), ``a_optimal`` or ``e_optimal``; or a function of
        the information matrix G = Y_bᵀY_b, SX (p, p) in the order of ``model.base_columns``, that
        returns the scalar expression to be minimized. A logarithm is well scaled.
    inertial_only : bool
        Leave the model's effects out, for comparison with the literature.
    limits : sequence of Limit, optional
        Limits besides those of the joints: `Torque`, `CartesianSpeed`, `Wall`, `Obstacle`,
        `SelfCollision`, `ExpressionLimit` for your own. Default: those of `default_limits`, which
        yours may follow: ``limits=[*default_limits(robot), mine]``; ``()`` leaves all out.
    start_pose : (n,), optional
        Pose at rest at start and end, rad. Default: the middle of the joint ranges or, where that
        is near a limit, a pose that is far from all limits.
    free_start : bool
        Let the trajectory start (at rest) at any pose; a motion from the start pose leads there.
    acceleration : float or (n,), optional
        Limits in place of the robot's, rad/s². Default: 3 where the robot states none.
    margin : float
        Part of the velocity limits, and of the torque limits by default, that is used.
    basis : str or Basis
        ``fourier`` (Eq. 19), ``modified_fourier``, ``bspline``, or an object with the members of
        `Basis`, whose duration is then used.
    duration : float
        Length of one period, s.
    harmonics : int
        Of the period's frequency; a B-spline has as many free coefficients.
    periods : int
        How often the period is repeated.
    samples : int
        Of the criterion over a period; limits are verified on a grid 20 times finer.
    rate : float
        Of the files, Hz.
    scaling : str or (P,)
        Of the full regressor's columns: ``si``, ``units`` (by the arm's mass and length),
        ``prior`` (by the size of the stated parameters), ``unit_norm`` (base columns of unit
        norm), or factors.
    condition_threshold : float, optional
        Δ₁ of ``combined`` (Eq. 20): a start ends at the first feasible trajectory whose condition
        number is at most this. Default: it is minimized.
    neg_log_det_threshold : float, optional
        Δ₂ of ``combined`` (Eq. 20): bound on −log det of the base regressor's Gram matrix, SI.
        Default: the value that minimizing 1/∏ of the column norms reaches, plus 0.5 a parameter.
    start : str or Path, optional
        Trajectory file (CSV with t, q1 … qn, as ``trajectory.csv``) of one period, from which the
        first search starts; its first pose is the start pose unless one is given.
    starts : int
        Number of starts; the best trajectory is returned. All are random but that from a file.
    seed : int
        Of the first start; the others follow. Results do not depend on threads, executors or the
        instruction set of the compiled functions. The rounding of the linear algebra depends on
        the processor, and the search amplifies it: between OpenBLAS kernels the condition number
        of the best of four starts changes by 1 to 10 %.
    max_iterations : int, optional
        Most iterations of one start; without it each stage of the search ends by its own
        tolerance. There is no limit in seconds, so that results do not depend on the load of the
        machine.
    progress : callable
        Called with what is done and the fraction that is done.
    executor : Executor, optional
        Of `concurrent.futures`, with the same result; without one the starts run one after the
        other, and an interrupt (Ctrl-C) keeps the best trajectory so far.

    Returns
    -------
    Excitation

    Raises
    ------
    ExcitationError
        Limits that are missing or contradictory, a start pose outside of them.
    NoSolution
        No start led to a trajectory within all limits; names the limit and what to relax.
    """
    began = time.monotonic()
    model = model_and_fit(source)[0]
    chosen = (
        families.make(basis, duration=duration, harmonics=harmonics)
        if isinstance(basis, str)
        else basis
    )
    duration = chosen.duration
    design = make_design(
        source, criterion=criterion, inertial_only=inertial_only, limits=limits,
        start_pose=start_pose, free_start=free_start, acceleration=acceleration, margin=margin,
        samples=samples,
        basis=chosen, scaling=scaling,
        condition_threshold=condition_threshold, neg_log_det_threshold=neg_log_det_threshold,
        start=start,
    )  # fmt: skip
    _check_counts(periods=periods, starts=starts, max_iterations=max_iterations, seed=seed)
    _check_rows(rate, duration, periods)
    progress("compiling", 0.0)
    problem = ExcitationProblem(design)
    built = time.monotonic()
    seeds = [seed + k for k in range(starts)]
    if start is not None:
        seeds = [WARM_START, *seeds[:-1]]
    attempts = solve_all(
        problem, seeds,
        progress=progress, executor=executor, max_iterations=max_iterations,
    )  # fmt: skip
    best = best_of(attempts)
    solved = time.monotonic()
    approach = RestToRest(problem.pose, problem.pose, 0.0)
    trajectory = problem.parametrization.trajectory(best.z)
    if free_start:
        begin = trajectory.at(np.zeros(1)).q[0]
        approach = approach_motion(problem.pose, begin, design.range, problem.sets, step=1.0 / rate)
    motion = trajectory.at(period_grid(duration, samples))
    violation, active = verification(problem, best.z)
    return Excitation(
        model=design.model, trajectory=trajectory, periods=periods, rest_pose=problem.pose,
        approach=approach, rate=rate, samples=samples, criterion=criterion_name(criterion),
        quality=quality(design.model, motion, design.column_scale, design.fit),
        scaling=scaling if isinstance(scaling, str) else "given",
        max_violation=violation, active_limits=active, starts=tuple(_start(a) for a in attempts),
        history=best.history,
        build_seconds=built - began, solve_seconds=solved - built,
        checked=checked_limits(design.range, design.limits, design.fit),
        unchecked=unchecked_limits(model.robot, design.limits, problem.left_out, design.fit),
        interrupted=any(a.interrupted for a in attempts),
        warnings=() if inertial_only else design_model(model)[1],
    )  # fmt: skip


def _check_counts(*, seed: int, **counts: int | None) -> None:
    for name, count in counts.items():
        if count is not None and count < 1:
            raise ExcitationError(f"{name}: {count}; expected 1 at least")
    if seed < 0:
        raise ExcitationError(f"seed: {seed}; expected 0 or a positive integer")


def _check_rows(rate: float, duration: float, periods: int) -> None:
    """Refuse a rate at which the trajectory file would be too long."""
    if not rate > 0.0:
        raise ExcitationError(f"rate: {rate:g} Hz; expected a positive number")
    if rate * duration * periods > MOST_ROWS:
        raise ExcitationError(
            f"rate: {rate:g} Hz gives {rate * duration * periods:.3g} rows in {periods} periods of "
            f"{duration:g} s; expected at most {MOST_ROWS}: lower the rate or the number of periods"
        )


def best_of(attempts: Sequence[StartAttempt]) -> OptimizedStart:
    """Return the best solution of several starts.

    Raises
    ------
    NoSolution
        No start has one; with the reason of the first.
    """
    solutions = [a.solution for a in attempts if a.solution is not None]
    if not solutions:
        count = f" ({len(attempts)} starts)" if len(attempts) > 1 else ""
        raise NoSolution(f"{attempts[0].reason}{count}")
    return min(solutions, key=lambda solution: solution.rank)


def verification(problem: ExcitationProblem, z: Array) -> tuple[float, tuple[ActiveLimit, ...]]:
    """Return the largest violation on the fine grid in the limit's unit, and the active limits."""
    exact = problem.constraints(FINE, margin=0.0)
    motion = exact.sampled.motion(z)
    worst, used = 0.0, []
    for limits in problem.sets:
        excess = limits.excess(limits.values(motion)).max(axis=1)
        worst = max(worst, float(excess.max()))
        used += [
            (label, 1.0 + float(e / s))
            for label, e, s in zip(limits.labels, excess, limits.scale, strict=True)
        ]
    return worst, active_limits(used)


def _start(attempt: StartAttempt) -> StartSummary:
    solution = attempt.solution
    seed = None if attempt.seed == WARM_START else attempt.seed
    if solution is None:
        return StartSummary(seed, np.nan, np.nan, attempt.seconds, np.nan)
    first = solution.history[0].condition_number if solution.history else np.nan
    return StartSummary(
        seed, solution.condition_number, solution.neg_log_det, solution.seconds, first
    )
