"""From a random start to a verified trajectory: the stages, and the best feasible iterate."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation.design_problem import COARSE, FINE, MARGIN, ExcitationProblem
from lieid_casadi.excitation.solvers.ipopt import Ipopt
from lieid_casadi.excitation.solvers.solver_interface import Iterate, Iteration, Solver
from lieid_casadi.excitation.solvers.sqp import Sqp
from lieid_casadi.excitation.solvers.stages import StagePlan, make_plan, volume_of

Array = NDArray[np.float64]
FEASIBLE = 0.5 * MARGIN  # scaled excess, margin included, that a kept iterate may have
FILLED = 0.9  # of the joint limits that a random start takes up
BADLY = 0.3  # scaled excess from which a start is made smaller
SMALLER = 6  # times at most
ROUNDS = 4  # of solving again on the fine grid
POLISH = 40  # iterations of one round
VOLUME_SLACK = 0.5  # of −log det per parameter: Δ₂ beyond what C3 reached
SOLVERS: dict[str, Callable[..., Solver]] = {"ipopt": Ipopt, "sqp": Sqp}
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class IterationRecord:
    """One iteration, as the criterion's history shows it."""

    stage: str
    seconds: float
    value: float
    condition_number: float
    violation: float


@dataclass(frozen=True, eq=False)
class OptimizedStart:
    """The best trajectory of one start.

    Attributes
    ----------
    z : (m,)
        Free variables.
    rank : float
        What solutions are compared by: smaller is better.
    interrupted : bool
        Whether the user ended it.
    """

    z: Array
    rank: float
    condition_number: float
    neg_log_det: float
    history: tuple[IterationRecord, ...]
    seconds: float
    seed: int
    interrupted: bool = False


@dataclass(eq=False)
class Tracker:
    """Keeps the history and the best iterate inside the limits.

    ``kept`` are all that were the best once; the last of them need not hold between the samples.
    """

    problem: ExcitationProblem
    rank: Callable[[Iterate], float]
    names: list[str]
    progress: Progress
    total: int
    best: Iterate | None = None
    best_rank: float = np.inf
    kept: list[Iterate] = field(default_factory=list)
    last: Iterate | None = None
    history: list[IterationRecord] = field(default_factory=list)
    started: float = field(default_factory=time.monotonic)

    def __call__(self, iteration: Iteration) -> None:
        """Take note of an iteration."""
        state = iteration.state
        self.last = state
        condition = self.problem.condition_number(state.outcome.gram)
        name = self.names[min(iteration.stage, len(self.names) - 1)]
        seconds = time.monotonic() - self.started
        self.history.append(
            IterationRecord(
                name, seconds, state.outcome.value, condition, max(state.violation, 0.0)
            )
        )
        if state.violation <= FEASIBLE and self.rank(state) < self.best_rank:
            self.best, self.best_rank = state, self.rank(state)
            self.kept.append(state)
        text = f"{name} {iteration.number + 1}, cond {condition:.4g}"
        if state.violation > FEASIBLE:
            text += f", {state.violation:.1e} beyond a limit"
        self.progress(text, min(1.0, len(self.history) / self.total))


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
        Of the random start.
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
        problem, plan.rank if plan.bounded_from is None else volume_of,
        [stage.criterion.name for stage in plan.stages], progress,
        sum(stage.iterations for stage in plan.stages),
    )  # fmt: skip
    solver = SOLVERS[problem.design.solver](
        problem.constraints(COARSE), problem.parametrization.size, tracker
    )
    z, ceiling, stopped = random_start(problem, seed), None, False
    try:
        for stage in plan.stages:
            iterations = stage.iterations
            if max_iterations is not None:
                iterations = min(iterations, max_iterations - len(tracker.history))
            if iterations <= 0:
                break
            if stage is plan.bounded_from:
                ceiling = ceiling_of(tracker)
                tracker.rank = plan.rank
            z = solver.minimize(
                problem.objective(stage.criterion, ceiling), z,
                iterations=iterations, tolerance=stage.tolerance,
            )  # fmt: skip
        z = verified(problem, solver, tracker, plan, ceiling)
    except KeyboardInterrupt:
        held = last_feasible(problem, tracker)
        if held is None:
            raise
        tracker.best, stopped, z = held, True, held.z
    assert tracker.best is not None
    gram = problem.gram(z)
    volume = float(np.linalg.slogdet(gram)[1])
    return OptimizedStart(
        z, plan.rank(tracker.best), problem.condition_number(gram), -volume,
        tuple(tracker.history), time.monotonic() - tracker.started, seed, stopped,
    )  # fmt: skip


def ceiling_of(tracker: Tracker) -> float:
    """Return Δ₂ per parameter: what the first stage reached, and some slack.

    At the exact value the feasible set nearly vanishes.
    """
    reached = tracker.best or tracker.last
    assert reached is not None
    tracker.best, tracker.best_rank = None, np.inf  # what follows must keep to Δ₂
    return volume_of(reached) + VOLUME_SLACK


def random_start(problem: ExcitationProblem, seed: int) -> Array:
    """Return free variables that fill 90 % of some joint limit of every joint.

    Where that breaks other limits badly, all joints move less.
    """
    parametrization = problem.parametrization
    generator = np.random.default_rng(seed)
    z = generator.normal(size=(parametrization.n, parametrization.directions_per_joint))
    motion = problem.samples.motion(z.ravel())
    units = problem.design.range.units
    from_pose = np.abs(motion.q - parametrization.pose)
    room = np.minimum(
        problem.design.range.position[:, 1] - parametrization.pose,
        parametrization.pose - problem.design.range.position[:, 0],
    )
    room = np.where(np.isfinite(room), room, units[:, 0])
    used = np.stack(
        [
            from_pose.max(axis=0) / room,
            np.abs(motion.dq).max(axis=0) / units[:, 1],
            np.abs(motion.ddq).max(axis=0) / units[:, 2],
        ]
    ).max(axis=0)
    start = np.ravel(FILLED * z / used[:, None])
    constraints = problem.constraints(1)
    for _ in range(SMALLER):
        excess = constraints.excess(constraints.sampled.motion(start))
        if constraints.largest(excess) <= BADLY:
            break
        start = 0.75 * start
    return start


def verified(
    problem: ExcitationProblem,
    solver: Solver,
    tracker: Tracker,
    plan: StagePlan,
    ceiling: float | None,
) -> Array:
    """Return the best iterate once the fine grid holds; solve on that grid as long as it does not.

    Raises
    ------
    NoSolution
    """
    exact = problem.constraints(FINE, margin=0.0)
    objective = problem.objective(plan.stages[-1].criterion, ceiling)
    for _ in range(ROUNDS):
        reached = tracker.best or tracker.last
        if reached is None:
            break
        excess = exact.excess(exact.sampled.motion(reached.z))
        if tracker.best is not None and exact.largest(excess) <= 0.0:
            return reached.z
        tracker.best, tracker.best_rank = None, np.inf
        solver.constraints = problem.constraints(FINE)
        solver.minimize(objective, reached.z, iterations=POLISH, tolerance=1e-5)
    raise NoSolution(infeasibility_reason(problem, tracker))


def last_feasible(problem: ExcitationProblem, tracker: Tracker) -> Iterate | None:
    """Return the last of the best iterates so far that holds on the fine grid."""
    exact = problem.constraints(FINE, margin=0.0)
    for state in reversed(tracker.kept):
        if exact.largest(exact.excess(exact.sampled.motion(state.z))) <= 0.0:
            return state
    return None


def infeasibility_reason(problem: ExcitationProblem, tracker: Tracker) -> str:
    """Return which limit the last iterate breaks most, where, by how much, and what to relax."""
    state = tracker.last
    if state is None:
        raise ExcitationError("no iteration was made; expected max_iterations of 1 at least")
    exact = problem.constraints(FINE, margin=0.0)
    motion = exact.sampled.motion(state.z)
    worst, told = -np.inf, ""
    for limits in exact.sets:
        excess = limits.excess(limits.values(motion))
        scaled = excess / limits.scale[:, None]
        k, sample = np.unravel_index(int(np.argmax(scaled)), scaled.shape)
        if scaled[k, sample] > worst:
            worst = float(scaled[k, sample])
            told = (
                f"{limits.labels[k]} passes its limit by {excess[k, sample]:.3g} "
                f"{limits.units[k]} at {motion.t[sample]:.3g} s; relax it: {limits.remedy}"
            )
    if worst <= 0.0:
        return (
            "the limits hold, but not together with the bound on −log det; "
            "use the criterion condition"
        )
    return f"no trajectory within all limits was found: {told}"
