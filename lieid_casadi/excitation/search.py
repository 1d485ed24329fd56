"""From random starts to verified trajectories: stages, best feasible iterate, several starts."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation.criteria import LogDet
from lieid_casadi.excitation.design import COARSE, DISTANCE, FINE, ExcitationProblem
from lieid_casadi.excitation.ipopt import Ipopt, Iterate

Progress = Callable[[str, float], None]
FEASIBLE = 0.5 * DISTANCE  # scaled excess, margin included, up to which an iterate is kept
FINE_ROUNDS = 4  # how often the problem is solved again on the fine grid
FINE_ITERATIONS = 40  # of one round
LEAST_DECREASE = 0.9  # of the violation in one round; rounds that gain less are the last
NEG_LOG_DET_SLACK = 0.5  # per parameter: Δ₂ above what the first stage reached


@dataclass(frozen=True, eq=False)
class StartAttempt:
    """Result of one start: the best trajectory that it led to, or the reason why there is none."""

    seed: int
    seconds: float
    z: Array | None = None  # (m,) free variables
    rank: float = np.nan  # smaller is better
    condition_number: float = np.nan
    neg_log_det: float = np.nan
    iterations: int = 0
    interrupted: bool = False
    reason: str = ""


class _ThresholdReached(Exception):
    """A feasible iterate meets the threshold of the search (Δ₁)."""


class Search:
    """The search from one random start.

    ``best`` is the best iterate inside the limits on the coarse grid; ``kept`` are all that were
    the best when they were found, of which the last may violate a limit between the samples.
    """

    def __init__(
        self,
        problem: ExcitationProblem,
        seed: int,
        *,
        progress: Progress = lambda stage, fraction: None,
        max_iterations: int | None = None,
    ) -> None:
        self.problem, self.seed, self._progress = problem, seed, progress
        self._left = max_iterations
        self._stages = problem.stages
        self._combined = problem.criterion == "combined"
        self._goal: float | None = None
        self._ceiling: float | None = None  # Δ₂ per parameter
        self._rank = neg_log_det_per_parameter if self._combined else self._final_rank
        self.best: Iterate | None = None
        self._best_rank = np.inf
        self.last: Iterate | None = None
        self.kept: list[Iterate] = []
        self.iterations = 0
        self._began = time.monotonic()
        self._solver = Ipopt(problem.constraints(COARSE), self._record)

    def solve(self) -> StartAttempt:
        """Run the stages and return the best trajectory within all limits."""
        interrupted = False
        try:
            self._run_stages(self.problem.random_start(self.seed))
            best = self._verified()
        except KeyboardInterrupt:
            inside = (s for s in reversed(self.kept) if self.problem.within_limits(s.z))
            feasible = next(inside, None)
            if feasible is None:
                raise
            best, interrupted = feasible, True
        gram = self.problem.gram(best.z)
        return StartAttempt(
            self.seed, time.monotonic() - self._began, best.z, self._final_rank(best),
            self.problem.condition_number(gram), -float(np.linalg.slogdet(gram)[1]),
            self.iterations, interrupted,
        )  # fmt: skip

    def _run_stages(self, z: Array) -> None:
        """Run the stages from z (m,); after the first one of ``combined`` −log det is bounded."""
        for number, stage in enumerate(self._stages):
            iterations = stage.iterations
            if self._left is not None:
                iterations = min(iterations, self._left - self.iterations)
            if iterations <= 0:
                return
            if self._combined and number == 1:
                self._ceiling = self._reached_ceiling()
                self._forget_best()  # the next iterates must meet Δ₂
                self._rank, self._goal = self._final_rank, self.problem.condition_threshold
            objective = self.problem.objective(stage.criterion, self._ceiling)
            try:
                z = self._solver.minimize(
                    objective, z, iterations=iterations, tolerance=stage.tolerance
                )
            except _ThresholdReached:
                return

    def _reached_ceiling(self) -> float:
        """Return Δ₂ per parameter: as given, or the value that the first stage reached and a slack.

        At the exact value the feasible set nearly vanishes.
        """
        given = self.problem.neg_log_det_threshold
        if given is not None:
            return given / self.problem.model.base.count
        reached = self.best or self.last
        assert reached is not None
        return neg_log_det_per_parameter(reached) + NEG_LOG_DET_SLACK

    def _final_rank(self, state: Iterate) -> float:
        """Return what compares iterates: the condition number, or the criterion's value."""
        if self.problem.criterion in ("combined", "condition"):
            return self.problem.condition_number(state.outcome.gram)
        return self._stages[-1].criterion.evaluate(state.outcome.gram)[0]

    def _record(self, stage: int, number: int, state: Iterate) -> None:
        self.last = state
        condition = self.problem.condition_number(state.outcome.gram)
        name = self._stages[min(stage, len(self._stages) - 1)].criterion.name
        self.iterations += 1
        feasible = state.violation <= FEASIBLE
        if feasible and self._rank(state) < self._best_rank:
            self.best, self._best_rank = state, self._rank(state)
            self.kept.append(state)
        text = f"{name} {number + 1}, cond {condition:.4g}"
        if not feasible:
            text += f", {state.violation:.1e} beyond a limit"
        total = sum(one.iterations for one in self._stages)
        self._progress(text, min(1.0, self.iterations / total))
        if self._goal is not None and self._best_rank <= self._goal:
            raise _ThresholdReached

    def _forget_best(self) -> None:
        """Discard the best iterate, because the problem changes."""
        self.best, self._best_rank = None, np.inf

    def _verified(self) -> Iterate:
        """Return the best iterate that meets all limits on the fine grid."""
        objective = self.problem.objective(self._stages[-1].criterion, self._ceiling)
        for _ in range(FINE_ROUNDS):
            reached = self.best or self.last
            if reached is None:
                break
            if self.best is not None and self.problem.within_limits(reached.z):
                return self.best
            self._forget_best()
            self._solver.constraints = self.problem.constraints(FINE)
            try:
                self._solver.minimize(
                    objective, reached.z, iterations=FINE_ITERATIONS, tolerance=1e-5
                )
            except _ThresholdReached:
                continue
            ended = self.last or reached
            if self.best is None and not ended.violation < LEAST_DECREASE * reached.violation:
                break
        raise NoSolution(self._reason())

    def _reason(self) -> str:
        """Return which limit the last iterate violates most, where, by how much, what to relax."""
        if self.last is None:
            raise ExcitationError("no iteration was made; expected max_iterations of 1 at least")
        worst = max(self.problem.excesses(self.last.z), key=lambda excess: excess.scaled)
        if worst.value <= 0.0:
            return (
                "all limits can be met, but not together with the bound on −log det; "
                "use the criterion condition, or a larger bound"
            )
        return (
            f"no trajectory within all limits was found: {worst.label} exceeds its limit by "
            f"{worst.value:.3g} {worst.unit} at {worst.time:.3g} s; to relax it: {worst.remedy}"
        )


def neg_log_det_per_parameter(state: Iterate) -> float:
    """Return −log det G per parameter."""
    return LogDet().evaluate(state.outcome.gram)[0]


def solve_all(
    problem: ExcitationProblem,
    seeds: Sequence[int],
    *,
    progress: Progress = lambda stage, fraction: None,
    max_iterations: int | None = None,
) -> list[StartAttempt]:
    """Return one attempt per seed; one without a solution has the reason.

    An interrupt (Ctrl-C) ends the search; what is feasible so far is kept, or else it is raised.
    """
    attempts: list[StartAttempt] = []
    for k, seed in enumerate(seeds):

        def report(stage: str, fraction: float, k: int = k) -> None:
            progress(f"start {k + 1} of {len(seeds)}: {stage}", (k + fraction) / len(seeds))

        began = time.monotonic()
        try:
            search = Search(problem, seed, progress=report, max_iterations=max_iterations)
            attempts.append(search.solve())
        except NoSolution as failure:
            attempts.append(StartAttempt(seed, time.monotonic() - began, reason=str(failure)))
        except KeyboardInterrupt:
            if all(a.z is None for a in attempts):
                raise
            attempts[-1] = replace(attempts[-1], interrupted=True)
        if attempts[-1].interrupted:
            break
    return attempts
