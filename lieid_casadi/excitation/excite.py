"""``excite``: from a model to the trajectory that identifies it best."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation.approach_motion import RestToRest, approach_motion
from lieid_casadi.excitation.basis import families
from lieid_casadi.excitation.basis.trajectory import period_grid
from lieid_casadi.excitation.criteria.column_scaling import column_scale
from lieid_casadi.excitation.criteria.criterion import NAMES
from lieid_casadi.excitation.criteria.design_model import design_model
from lieid_casadi.excitation.criteria.quality import quality
from lieid_casadi.excitation.design_problem import FINE, ExcitationDesign, ExcitationProblem
from lieid_casadi.excitation.excitation import ActiveLimit, Excitation, StartSummary, active_limits
from lieid_casadi.excitation.limits.joint_limits import (
    check_duration,
    check_start_pose,
    motion_range,
)
from lieid_casadi.excitation.limits.symbolic_limits import Limit, Torque
from lieid_casadi.excitation.solvers.multi_start import StartAttempt, solve_all
from lieid_casadi.excitation.solvers.staged_solve import SOLVERS, OptimizedStart
from lieid_casadi.model import Model

Array = NDArray[np.float64]


@blas_on_one_thread
def excite(
    model: Model,
    *,
    criterion: str = "combined",
    inertial_only: bool = False,
    constraints: Sequence[Limit] | None = None,
    start_pose: ArrayLike | None = None,
    free_start: bool = False,
    acceleration: ArrayLike | None = None,
    family: str = "fourier",
    duration: float = 20.0,
    harmonics: int = 5,
    periods: int = 1,
    samples: int = 100,
    rate: float = 1000.0,
    scaling: str | ArrayLike = "si",
    solver: str = "ipopt",
    starts: int = 4,
    seed: int = 0,
    max_iterations: int | None = None,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
    executor: Executor | None = None,
) -> Excitation:
    """Design an optimal excitation trajectory that is safe to run as it is.

    The regressor that counts is the model's own, effects included, as far as it follows from motion
    and time; warnings name what does not (temperature, memory, effects on the whole arm).

    Parameters
    ----------
    criterion : str
        ``combined`` (the paper's C1: condition number with a bound on −log det), ``condition``
        (C2), ``hadamard`` (C3), ``logdet`` (C4), ``a_optimal`` or ``e_optimal``.
    inertial_only : bool
        Leave the model's effects out, for comparison with the literature.
    constraints : sequence of Limit, optional
        Beside the joint limits: `Torque`, `CartesianSpeed`, `Wall`, `Obstacle`, `SelfCollision`.
        If left out: torque, where the robot states inertias and torque limits.
    start_pose : (n,), optional
        Pose at rest at start and end, rad; the middle of the joint ranges if left out.
    free_start : bool
        Let the trajectory start (at rest) where it likes; a run-in leads there from the start pose.
    acceleration : float or (n,), optional
        Limits in place of the robot's, rad/s²; 5 where neither states one.
    family : str
        ``fourier`` (Eq. 19), ``modified_fourier`` or ``spline``.
    duration, harmonics, periods
        Length of a period in s, harmonics of its frequency, how often it is repeated.
    samples : int
        Of the criterion over a period; limits are verified on a grid 20 times finer.
    rate : float
        Of the files, Hz.
    scaling : str or (P,)
        Of the full regressor's columns: ``si``, ``units`` (by the arm's mass and length),
        ``prior`` (by the size of the stated parameters), or factors.
    solver : str
        ``ipopt``, or ``sqp``: a sequential quadratic programme of this library, which needs less
        time and ends at slightly larger condition numbers (tests/benchmarks/excitation_ipopt.py).
    starts : int
        Random starts, of which the best is kept.
    max_iterations : int, optional
        Most iterations of one start; without it each stage of the search ends by its own
        tolerance. There is no limit in seconds: the same seed gives the same trajectory on a
        busy machine.
    progress : callable
        Called with what is done and the fraction that is done.
    executor : Executor, optional
        Any of `concurrent.futures`; without one the starts run one after the other. Ctrl-C then
        keeps the best trajectory so far.

    Raises
    ------
    ExcitationError
        Limits that are missing or contradict each other, a start pose outside of them.
    NoSolution
        No start led to a trajectory within all limits; says which limit and what to relax.
    """
    began = time.monotonic()
    design = make_design(
        model, criterion=criterion, inertial_only=inertial_only, constraints=constraints,
        start_pose=start_pose, free_start=free_start, acceleration=acceleration, samples=samples,
        basis=families.make(family, duration=duration, harmonics=harmonics), scaling=scaling,
        solver=solver,
    )  # fmt: skip
    for name, count in (
        ("periods", periods), ("starts", starts), ("max_iterations", max_iterations),
    ):  # fmt: skip
        if count is not None and count < 1:
            raise ExcitationError(f"{name}: {count}; expected 1 at least")
    if seed < 0:
        raise ExcitationError(f"seed: {seed}; expected 0 or a positive integer")
    if not rate > 0.0:
        raise ExcitationError(f"rate: {rate:g} Hz; expected a positive number")
    progress("compiling", 0.0)
    problem = ExcitationProblem(design)
    built = time.monotonic()
    attempts = solve_all(
        problem, [seed + k for k in range(starts)],
        progress=progress, executor=executor, max_iterations=max_iterations,
    )  # fmt: skip
    best = best_of(attempts)
    solved = time.monotonic()
    way = RestToRest(design.pose, design.pose, 0.0)
    trajectory = problem.parametrization.trajectory(best.z)
    if free_start:
        here = trajectory.at(np.zeros(1)).q[0]
        way = approach_motion(design.pose, here, design.range, problem.sets, step=1.0 / rate)
    judged = quality(
        design.model,
        trajectory.at(period_grid(duration, samples)),
        None if np.all(design.column_scale == 1.0) else design.column_scale,
    )
    violation, active = verification(problem, best.z)
    return Excitation(
        model=design.model, trajectory=trajectory, periods=periods, rest_pose=design.pose,
        approach=way, rate=rate, samples=samples, quality=judged, criterion=criterion,
        scaling=scaling if isinstance(scaling, str) else "given", solver=solver,
        max_violation=violation, active_limits=active, starts=tuple(_start(a) for a in attempts),
        history=best.history,
        build_seconds=built - began, solve_seconds=solved - built,
        interrupted=any(a.interrupted for a in attempts),
        warnings=() if inertial_only else design_model(model)[1],
    )  # fmt: skip


def make_design(
    model: Model,
    *,
    basis: families.Basis,
    criterion: str = "combined",
    inertial_only: bool = False,
    constraints: Sequence[Limit] | None = None,
    start_pose: ArrayLike | None = None,
    free_start: bool = False,
    acceleration: ArrayLike | None = None,
    samples: int = 100,
    scaling: str | ArrayLike = "si",
    solver: str = "ipopt",
) -> ExcitationDesign:
    """Check what is asked for and put it together; see `excite`."""
    if criterion not in NAMES:
        raise ExcitationError(f"criterion: {criterion!r}; expected one of {', '.join(NAMES)}")
    if solver not in SOLVERS:
        raise ExcitationError(f"solver: {solver!r}; expected one of {', '.join(SOLVERS)}")
    if samples < 4 * basis.size:
        raise ExcitationError(
            f"samples: {samples}; expected {4 * basis.size} at least for {basis.size} "
            "coefficients a joint"
        )
    seen = Model(model.robot) if inertial_only else design_model(model)[0]
    robot = seen.robot
    limits = motion_range(robot, acceleration)
    check_duration(robot, limits, basis.duration)
    pose = limits.middle if start_pose is None else np.asarray(start_pose, dtype=float)
    check_start_pose(robot, limits, pose)
    if constraints is None:
        known = robot.has_inertia and bool(np.isfinite(robot.limit("torque")).any())
        constraints = (Torque(),) if known else ()
    return ExcitationDesign(
        seen, basis, samples, limits, tuple(constraints), pose, not free_start, criterion,
        column_scale(seen, scaling), solver,
    )  # fmt: skip


def best_of(attempts: Sequence[StartAttempt]) -> OptimizedStart:
    """Return the best solution.

    Raises
    ------
    NoSolution
        No attempt has one; with the reason of the first.
    """
    solutions = [a.solution for a in attempts if a.solution is not None]
    if not solutions:
        count = f" ({len(attempts)} starts)" if len(attempts) > 1 else ""
        raise NoSolution(f"{attempts[0].reason}{count}")
    return min(solutions, key=lambda solution: solution.rank)


def verification(problem: ExcitationProblem, z: Array) -> tuple[float, tuple[ActiveLimit, ...]]:
    """Return the largest violation on the fine grid, and which limits bind."""
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
    if solution is None:
        return StartSummary(attempt.seed, np.nan, np.nan, attempt.seconds, np.nan)
    first = solution.history[0].condition_number if solution.history else np.nan
    return StartSummary(
        attempt.seed, solution.condition_number, solution.neg_log_det, solution.seconds, first
    )
