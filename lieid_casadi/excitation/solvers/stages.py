"""The stages that lead to a criterion's optimum, and what their iterates are compared by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lieid_casadi.excitation.criteria import criterion
from lieid_casadi.excitation.criteria.criterion import Criterion, Hadamard, LogDet, Stage
from lieid_casadi.excitation.design_problem import Problem
from lieid_casadi.excitation.solvers.solver import State


@dataclass(frozen=True, eq=False)
class Plan:
    """Stages of a criterion; from ``bounded_from`` on, −log det is bounded (Δ₂)."""

    stages: tuple[Stage, ...]
    rank: Callable[[State], float]
    bounded_from: Stage | None = None


def make_plan(problem: Problem) -> Plan:
    """Return the stages of the design's criterion.

    ``combined`` is the paper's: 1/∏ of the column norms first, then the condition number while
    −log det stays below what the first stage reached and a slack.
    """
    name = problem.design.criterion

    def by_condition(state: State) -> float:
        return problem.condition_number(state.outcome.gram)

    if name == "combined":
        start = Stage(Hadamard(), 60, 1e-5)
        then = criterion.condition_stages(problem.metric)
        return Plan((start, *then), by_condition, then[0])
    stages = criterion.stages(name, problem.metric)
    if name == "condition":
        return Plan(stages, by_condition)
    last = stages[-1].criterion
    return Plan(stages, lambda state: value_of(last, state))


def value_of(criterion: Criterion, state: State) -> float:
    """Return a criterion's value at a state that may come from another stage."""
    return criterion.evaluate(state.outcome.gram)[0]


def volume_of(state: State) -> float:
    """Return −log det G per parameter."""
    return value_of(LogDet(), state)
