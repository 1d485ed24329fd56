"""From random starts to verified trajectories: stages, best feasible iterate, several starts."""

from __future__ import annotations

import pickle
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation.criteria import (
    Criterion,
    CriterionStage,
    ExpressionCriterion,
    Hadamard,
    LogDet,
    stages,
)
from lieid_casadi.excitation.design import (
    COARSE,
    DISTANCE,
    FINE,
    ExcitationDesign,
    ExcitationProblem,
    random_start,
    warm_start,
)
from lieid_casadi.excitation.ipopt import Ipopt, Iterate, Iteration

OWN_FIRST_ITERATIONS = 15  # of −log det before a criterion of the user's
FIRST_STAGE_ITERATIONS = 60  # of 1/∏ of the column norms, at most


@dataclass(frozen=True, eq=False)
class StagePlan:
    """Stages of a criterion.

    Attributes
    ----------
    stages : tuple of CriterionStage
    rank : callable
        Quantity by which iterates are compared; the smallest is kept.
    bounded_from : CriterionStage, optional
        Stage from which on −log det is bounded (Δ₂).
    ceiling : float, optional
        Δ₂ per parameter; from the stages before if left out.
    goal : float, optional
        Rank at which the search ends (Δ₁).
    """

    stages: tuple[CriterionStage, ...]
    rank: Callable[[Iterate], float]
    bounded_from: CriterionStage | None = None
    ceiling: float | None = None
    goal: float | None = None


def make_plan(problem: ExcitationProblem) -> StagePlan:
    """Return the stages of the design's criterion.

    ``combined`` is the paper's C1 (Eq. 20): 1/∏ of the column norms first, then the condition
    number while −log det stays below Δ₂, until it is at most Δ₁.
    """
    design = problem.design
    unit_norm = design.column_scale is None

    def by_condition(state: Iterate) -> float:
        return problem.condition_number(state.outcome.gram)

    if design.criterion == "combined":
        first = CriterionStage(Hadamard(), FIRST_STAGE_ITERATIONS, 1e-5)
        then = stages("condition", problem.metric, unit_norm=unit_norm)
        bound, count = design.neg_log_det_threshold, design.model.base.count
        return StagePlan(
            (first, *then), by_condition, bounded_from=then[0],
            ceiling=None if bound is None else bound / count, goal=design.condition_threshold,
        )  # fmt: skip
    if not isinstance(design.criterion, str):
        own = ExpressionCriterion(design.criterion, design.model.base.count)
        begin = CriterionStage(LogDet(), OWN_FIRST_ITERATIONS)
        return StagePlan(
            (begin, CriterionStage(own, 200, 1e-5)), lambda state: value_of(own, state)
        )
    named = stages(design.criterion, problem.metric, unit_norm=unit_norm)
    if design.criterion == "condition":
        return StagePlan(named, by_condition)
    last = named[-1].criterion
    return StagePlan(named, lambda state: value_of(last, state))


def value_of(criterion: Criterion, state: Iterate) -> float:
    """Return a criterion's value at a state that may come from another stage."""
    return criterion.evaluate(state.outcome.gram)[0]


def neg_log_det_per_parameter(state: Iterate) -> float:
    """Return −log det G per parameter."""
    return value_of(LogDet(), state)


FEASIBLE = 0.5 * DISTANCE  # scaled excess, margin included, up to which an iterate is kept
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class IterationRecord:
    """One iteration in the history of a search.

    Attributes
    ----------
    stage : str
        Name of the criterion.
    seconds : float
        Since the start of the search.
    value : float
        Of the criterion.
    condition_number : float
    violation : float
        Largest scaled excess over a limit, margin included.
    """

    stage: str
    seconds: float
    value: float
    condition_number: float
    violation: float


class ThresholdReached(Exception):
    """A feasible iterate meets the threshold of the search (Δ₁)."""


@dataclass(eq=False)
class Tracker:
    """Records the history and the best iterate inside the limits.

    ``kept`` are all iterates that were the best when they were found; the last of them may violate
    a limit between the samples.
    """

    problem: ExcitationProblem
    rank: Callable[[Iterate], float]
    names: list[str]
    progress: Progress
    total: int
    goal: float | None = None
    best: Iterate | None = None
    best_rank: float = np.inf
    kept: list[Iterate] = field(default_factory=list)
    last: Iterate | None = None
    history: list[IterationRecord] = field(default_factory=list)
    started: float = field(default_factory=time.monotonic)

    def __call__(self, iteration: Iteration) -> None:
        """Record an iteration.

        Raises
        ------
        ThresholdReached
        """
        state = iteration.state
        self.last = state
        condition = self.problem.condition_number(state.outcome.gram)
        name = self.names[min(iteration.stage, len(self.names) - 1)]
        seconds, violation = time.monotonic() - self.started, max(state.violation, 0.0)
        self.history.append(
            IterationRecord(name, seconds, state.outcome.value, condition, violation)
        )
        if state.violation <= FEASIBLE and self.rank(state) < self.best_rank:
            self.best, self.best_rank = state, self.rank(state)
            self.kept.append(state)
        text = f"{name} {iteration.number + 1}, cond {condition:.4g}"
        if state.violation > FEASIBLE:
            text += f", {state.violation:.1e} beyond a limit"
        self.progress(text, min(1.0, len(self.history) / self.total))
        if self.goal is not None and self.best_rank <= self.goal:
            raise ThresholdReached

    def forget_best(self) -> None:
        """Discard the best iterate, because the problem changes."""
        self.best, self.best_rank = None, np.inf


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


@dataclass(frozen=True, eq=False)
class StartAttempt:
    """Result of one random start: a solution, or the reason why there is none."""

    seed: int
    seconds: float
    solution: OptimizedStart | None = None
    reason: str = ""
    interrupted: bool = False


def solve_all(
    problem: ExcitationProblem,
    seeds: Sequence[int],
    *,
    progress: Progress = lambda stage, fraction: None,
    executor: Executor | None = None,
    max_iterations: int | None = None,
) -> list[StartAttempt]:
    """Return one attempt per seed; the result does not depend on the executor.

    An interrupt (Ctrl-C) ends the search; complete attempts and the best iterate of the current
    one are kept.

    Parameters
    ----------
    problem : ExcitationProblem
    seeds : sequence of int
        One per start.
    progress : callable, optional
        Called with what is done and the fraction that is done.
    executor : Executor, optional
        Of `concurrent.futures`; without one the starts run one after the other.
    max_iterations : int, optional
        Of each start.

    Raises
    ------
    KeyboardInterrupt
        Before a feasible trajectory was found.
    """
    if executor is not None:
        jobs = [
            executor.submit(attempt_design, problem.design, seed, max_iterations) for seed in seeds
        ]
        attempts = []
        for k, job in enumerate(jobs):
            attempts.append(job.result())
            progress(f"start {k + 1} of {len(jobs)}", (k + 1) / len(jobs))
        return attempts
    attempts = []
    for k, seed in enumerate(seeds):

        def report(stage: str, fraction: float, k: int = k) -> None:
            progress(f"start {k + 1} of {len(seeds)}: {stage}", (k + fraction) / len(seeds))

        try:
            attempts.append(attempt(problem, seed, progress=report, max_iterations=max_iterations))
        except KeyboardInterrupt:
            if not any(a.solution for a in attempts):
                raise
            attempts[-1] = replace(attempts[-1], interrupted=True)
            break
        if attempts[-1].interrupted:
            break
    return attempts


def attempt(
    problem: ExcitationProblem,
    seed: int,
    *,
    progress: Progress = lambda stage, fraction: None,
    max_iterations: int | None = None,
) -> StartAttempt:
    """Solve from one start; a start without a solution does not raise.

    Parameters
    ----------
    problem : ExcitationProblem
    seed : int
        Of the start.
    progress : callable
        Called with a stage's name and the fraction done.
    max_iterations : int, optional
        Of the solver; no limit if left out.
    """
    began = time.monotonic()
    try:
        solution = solve(problem, seed, progress=progress, max_iterations=max_iterations)
    except NoSolution as failure:
        return StartAttempt(seed, time.monotonic() - began, reason=str(failure))
    return StartAttempt(seed, time.monotonic() - began, solution, interrupted=solution.interrupted)


@blas_on_one_thread
def attempt_design(design: ExcitationDesign, seed: int, max_iterations: int | None) -> StartAttempt:
    """Solve from one start on an executor; compiled code comes from the cache there.

    Parameters
    ----------
    design : ExcitationDesign
    seed : int
        Of the start.
    max_iterations : int or None
        Of the solver.
    """
    return attempt(_problem(design), seed, max_iterations=max_iterations)


_last = threading.local()  # the last problem of each thread; threads share none


def _problem(design: ExcitationDesign) -> ExcitationProblem:
    key = pickle.dumps(design)
    if getattr(_last, "key", None) != key:
        _last.key, _last.problem = key, ExcitationProblem(design)
    problem: ExcitationProblem = _last.problem
    return problem
