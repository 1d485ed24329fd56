"""Linear fit, shapes and load in turn, until the predicted torque settles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification.regression.design_matrix import Design, Rows, varying_columns
from lieid_casadi.identification.regression.least_squares import Solution, solve
from lieid_casadi.identification.regression.variable_projection import fit_shapes
from lieid_casadi.identification.regression.weights import ESTIMATORS, Weighting
from lieid_casadi.model import Model

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
ROUNDS = 30  # of the fixed point over load and shapes
SETTLED = 1e-6  # relative change of the predicted torque


@dataclass(frozen=True, eq=False)
class State:
    """One round's result.

    Attributes
    ----------
    shapes : (s,)
    rows : Rows
        At these shapes, and at the load that the round before predicted.
    parameters : (10 n + m,)
        Link parameters and effect coefficients that give ``solution.values``.
    """

    shapes: Array
    rows: Rows
    weighting: Weighting
    solution: Solution
    parameters: Array


@dataclass(frozen=True, eq=False)
class ShapeStart:
    """Shape parameters (s,) to start from, near the solution; ``held`` leaves them there."""

    values: Array
    held: bool = False


def fixed_point(
    design: Design, method: str, report: Progress, start: ShapeStart | None = None
) -> tuple[State, bool]:
    """Alternate linear fit, shapes and load until the predicted torque settles.

    Without a start, shapes are searched over their whole range.
    """
    model = design.model
    estimator = ESTIMATORS[method]
    shapes, links = model.initial_shapes if start is None else start.values, None
    held = start is not None and start.held
    moving = bool(varying_columns(model).any())
    loaded = any("load" in p.effect.signals for p in model.placements)
    searched = start is not None
    before: Array | None = None
    for round_ in range(ROUNDS):
        rows = design.rows(shapes, links)
        weighting = estimator(rows)
        # shapes of a load need one
        if len(shapes) and not held and not (loaded and links is None):
            shapes = fit_shapes(design, shapes, links, weighting.noise, search=not searched)
            searched = True
            rows = design.rows(shapes, links)
            weighting = estimator(rows)
        solution = solve(weighting.factor)
        parameters = model.base.lift(solution.values, prior(model))
        state = State(shapes, rows, weighting, solution, parameters)
        if not moving:
            return state, weighting.converged
        links = parameters
        predicted = rows.predicted(solution.values)
        if before is not None and has_settled(predicted, before):
            return state, weighting.converged
        before = predicted
        report("regress", 0.3 + 0.6 * (round_ + 1) / ROUNDS)
    return state, False


def prior(model: Model) -> Array:
    """Return nominal link parameters (zero where none are stated) and no effects."""
    links = model.robot.link_parameters if model.robot.has_inertia else np.zeros(10 * model.n)
    return np.concatenate([links, np.zeros(len(model.columns))])


def has_settled(predicted: Array, before: Array) -> bool:
    """Whether two rounds predict the same torque."""
    return bool(np.linalg.norm(predicted - before) <= SETTLED * np.linalg.norm(predicted))
