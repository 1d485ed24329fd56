"""History and best iterate of a search."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from lieid_casadi.excitation.design_problem import MARGIN, ExcitationProblem
from lieid_casadi.excitation.solvers.iterates import Iterate, Iteration

FEASIBLE = 0.5 * MARGIN  # scaled excess, margin included, up to which an iterate is kept
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
