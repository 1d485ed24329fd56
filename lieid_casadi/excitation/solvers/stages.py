"""The stages that lead to a criterion's optimum, and the quantity that compares their iterates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lieid_casadi.excitation.criteria import criterion
from lieid_casadi.excitation.criteria.criterion import (
    Criterion,
    CriterionStage,
    ExpressionCriterion,
    Hadamard,
    LogDet,
)
from lieid_casadi.excitation.design_problem import ExcitationProblem
from lieid_casadi.excitation.solvers.iterates import Iterate

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
        then = criterion.stages("condition", problem.metric, unit_norm=unit_norm)
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
    stages = criterion.stages(design.criterion, problem.metric, unit_norm=unit_norm)
    if design.criterion == "condition":
        return StagePlan(stages, by_condition)
    last = stages[-1].criterion
    return StagePlan(stages, lambda state: value_of(last, state))


def value_of(criterion: Criterion, state: Iterate) -> float:
    """Return a criterion's value at a state that may come from another stage."""
    return criterion.evaluate(state.outcome.gram)[0]


def neg_log_det_per_parameter(state: Iterate) -> float:
    """Return −log det G per parameter."""
    return value_of(LogDet(), state)
