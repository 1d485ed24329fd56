"""The stages that lead to a criterion's optimum, and what their iterates are compared by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lieid_casadi.excitation.criteria import criterion
from lieid_casadi.excitation.criteria.criterion import Criterion, CriterionStage, Hadamard, LogDet
from lieid_casadi.excitation.design_problem import ExcitationProblem
from lieid_casadi.excitation.solvers.solver_interface import Iterate


@dataclass(frozen=True, eq=False)
class StagePlan:
    """Stages of a criterion; from ``bounded_from`` on, −log det is bounded (Δ₂)."""

    stages: tuple[CriterionStage, ...]
    rank: Callable[[Iterate], float]
    bounded_from: CriterionStage | None = None


def make_plan(problem: ExcitationProblem) -> StagePlan:
    """Return the stages of the design's criterion.

    ``combined`` is the paper's: 1/∏ of the column norms first, then the condition number while
    −log det stays below what the first stage reached and a slack.
    """
    name = problem.design.criterion

    def by_condition(state: Iterate) -> float:
        return problem.condition_number(state.outcome.gram)

    if name == "combined":
        start = CriterionStage(Hadamard(), 60, 1e-5)
        then = criterion.condition_stages(problem.metric)
        return StagePlan((start, *then), by_condition, then[0])
    stages = criterion.stages(name, problem.metric)
    if name == "condition":
        return StagePlan(stages, by_condition)
    last = stages[-1].criterion
    return StagePlan(stages, lambda state: value_of(last, state))


def value_of(criterion: Criterion, state: Iterate) -> float:
    """Return a criterion's value at a state that may come from another stage."""
    return criterion.evaluate(state.outcome.gram)[0]


def volume_of(state: Iterate) -> float:
    """Return −log det G per parameter."""
    return value_of(LogDet(), state)
