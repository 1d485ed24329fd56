"""From a random start to a verified trajectory: the stages, and the best feasible iterate."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation.design_problem import COARSE, FINE, ExcitationProblem
from lieid_casadi.excitation.solvers.ipopt import Ipopt
from lieid_casadi.excitation.solvers.iterates import Iterate
from lieid_casadi.excitation.solvers.random_start import random_start
from lieid_casadi.excitation.solvers.stages import (
    StagePlan,
    make_plan,
    neg_log_det_per_parameter,
)
from lieid_casadi.excitation.solvers.tracker import (
    IterationRecord,
    Progress,
    ThresholdReached,
    Tracker,
)
from lieid_casadi.excitation.solvers.warm_start import warm_start

Array = NDArray[np.float64]
FINE_ROUNDS = 4  # how often the problem is solved again on the fine grid
FINE_ITERATIONS = 40  # of one round
FINE_TOLERANCE = 1e-5
LEAST_DECREASE = 0.9  # of the violation in one round; rounds that gain less are the last
NEG_LOG_DET_SLACK = 0.5  # per parameter: Δ₂ above what the first stage reached
WARM_START = -1  # in place of the seed of a random start


@dataclass(frozen=True, eq=False)
class OptimizedStart:
    """The best trajectory that one random start led to.

    Attributes
    ----------
    z : (m,)
        Free variables.
    rank : float
        Quantity by which solutions are compared; the smaller, the better.
    condition_number : float
    neg_log_det : float
    history : tuple of IterationRecord
    seconds : float
    seed : int
    interrupted : bool
        Whether the user interrupted the search.
    """

    z: Array
    rank: float
    condition_number: float
    neg_log_det: float
    history: tuple[IterationRecord, ...]
    seconds: float
    seed: int
    interrupted: bool = False


def solve(
    problem: ExcitationProblem,
    seed: int,
    *,
    progress: Progress = lambda stage, fraction: None,
    max_iterations: int | None = None,
) -> OptimizedStart:
    """Optimize from one random start and verify on the fine grid.

    Parameters
    ----------
    problem : ExcitationProblem
    seed : int
        Of the random start, or `WARM_START`.
    progress : callable, optional
        Called with the stage and the fraction that is done.
    max_iterations : int, optional
        Iterations of all stages together; without it each stage ends by its own tolerance.
        Iterations that restore a limit on the fine grid come on top.

    Raises
    ------
    NoSolution
        Names the limit that could not be met, where and by how much, and what to relax.
    """
    plan = make_plan(problem)
    tracker = Tracker(
        problem, plan.rank if plan.bounded_from is None else neg_log_det_per_parameter,
        [stage.criterion.name for stage in plan.stages], progress,
        sum(stage.iterations for stage in plan.stages),
    )  # fmt: skip
    solver = Ipopt(problem.constraints(COARSE), problem.parametrization.size, tracker)
    interrupted = False
    try:
        start = first_variables(problem, seed)
        ceiling = run_stages(problem, plan, solver, tracker, start, max_iterations)
        best = verified(problem, plan, solver, tracker, ceiling)
    except KeyboardInterrupt:
        feasible = last_feasible(problem, tracker)
        if feasible is None:
            raise
        best, interrupted = feasible, True
    gram = problem.gram(best.z)
    return OptimizedStart(
        best.z, plan.rank(best), problem.condition_number(gram),
        -float(np.linalg.slogdet(gram)[1]), tuple(tracker.history),
        time.monotonic() - tracker.started, seed, interrupted,
    )  # fmt: skip


def first_variables(problem: ExcitationProblem, seed: int) -> Array:
    """Return the free variables (m,) of a random start, or of the design's for `WARM_START`."""
    if seed == WARM_START:
        assert problem.design.start is not None
        return warm_start(problem.parametrization, problem.design.start)
    return random_start(problem, seed)


def run_stages(
    problem: ExcitationProblem,
    plan: StagePlan,
    solver: Ipopt,
    tracker: Tracker,
    z: Array,
    max_iterations: int | None,
) -> float | None:
    """Run the stages one after the other from z (m,) and return Δ₂ per parameter, if any.

    Parameters
    ----------
    problem : ExcitationProblem
    plan : StagePlan
    solver : Ipopt
    tracker : Tracker
        Records the iterates.
    z : (m,)
        Start: coefficients of the trajectory.
    max_iterations : int or None
        Of all stages together.
    """
    ceiling: float | None = None
    for stage in plan.stages:
        iterations = stage.iterations
        if max_iterations is not None:
            iterations = min(iterations, max_iterations - len(tracker.history))
        if iterations <= 0:
            break
        if stage is plan.bounded_from:
            ceiling = reached_ceiling(tracker) if plan.ceiling is None else plan.ceiling
            tracker.forget_best()  # the next iterates must meet Δ₂
            tracker.rank, tracker.goal = plan.rank, plan.goal
        objective = problem.objective(stage.criterion, ceiling)
        try:
            z = solver.minimize(objective, z, iterations=iterations, tolerance=stage.tolerance)
        except ThresholdReached:
            break
    return ceiling


def reached_ceiling(tracker: Tracker) -> float:
    """Return Δ₂ per parameter: the value that the first stage reached, and a slack.

    At the exact value the feasible set nearly vanishes.
    """
    reached = tracker.best or tracker.last
    assert reached is not None
    return neg_log_det_per_parameter(reached) + NEG_LOG_DET_SLACK


def verified(
    problem: ExcitationProblem,
    plan: StagePlan,
    solver: Ipopt,
    tracker: Tracker,
    ceiling: float | None,
) -> Iterate:
    """Return the best iterate that meets all limits on the fine grid.

    Where the best iterate does not, the problem is solved again on the fine grid.

    Parameters
    ----------
    problem : ExcitationProblem
    plan : StagePlan
    solver : Ipopt
    tracker : Tracker
        With the iterates so far.
    ceiling : float or None
        Δ₂ per parameter.

    Raises
    ------
    NoSolution
    """
    exact = problem.constraints(FINE, margin=0.0)
    objective = problem.objective(plan.stages[-1].criterion, ceiling)
    for _ in range(FINE_ROUNDS):
        reached = tracker.best or tracker.last
        if reached is None:
            break
        excess = exact.excess(exact.sampled.motion(reached.z))
        if tracker.best is not None and exact.largest(excess) <= 0.0:
            return tracker.best
        tracker.forget_best()
        violation = reached.violation
        solver.constraints = problem.constraints(FINE)
        try:
            solver.minimize(
                objective, reached.z, iterations=FINE_ITERATIONS, tolerance=FINE_TOLERANCE
            )
        except ThresholdReached:
            continue
        ended = tracker.last or reached
        if tracker.best is None and not ended.violation < LEAST_DECREASE * violation:
            break
    raise NoSolution(infeasibility_reason(problem, tracker))


def last_feasible(problem: ExcitationProblem, tracker: Tracker) -> Iterate | None:
    """Return the last of the best iterates so far that meets all limits on the fine grid."""
    exact = problem.constraints(FINE, margin=0.0)
    for state in reversed(tracker.kept):
        if exact.largest(exact.excess(exact.sampled.motion(state.z))) <= 0.0:
            return state
    return None


def infeasibility_reason(problem: ExcitationProblem, tracker: Tracker) -> str:
    """Return which limit the last iterate violates most, where, by how much, what to relax."""
    state = tracker.last
    if state is None:
        raise ExcitationError("no iteration was made; expected max_iterations of 1 at least")
    exact = problem.constraints(FINE, margin=0.0)
    motion = exact.sampled.motion(state.z)
    worst, reason = -np.inf, ""
    for limits in exact.sets:
        excess = limits.excess(limits.values(motion))
        scaled = excess / limits.scale[:, None]
        k, sample = np.unravel_index(int(np.argmax(scaled)), scaled.shape)
        if scaled[k, sample] > worst:
            worst = float(scaled[k, sample])
            reason = (
                f"{limits.labels[k]} exceeds its limit by {excess[k, sample]:.3g} "
                f"{limits.units[k]} at {motion.t[sample]:.3g} s; to relax it: {limits.remedy}"
            )
    if worst <= 0.0:
        return (
            "all limits can be met, but not together with the bound on −log det; "
            "use the criterion condition, or a larger bound"
        )
    return f"no trajectory within all limits was found: {reason}"
