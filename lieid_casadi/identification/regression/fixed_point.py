"""Fixed-point iteration over linear parameters, shape parameters and load."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.effects import ArmEffect
from lieid_casadi.identification.regression.design_matrix import Design, Rows, varying_columns
from lieid_casadi.identification.regression.least_squares import (
    ESTIMATORS,
    LeastSquaresSolution,
    Weighting,
    solve,
)
from lieid_casadi.identification.regression.shape_fit import fit_shapes
from lieid_casadi.identification.regression.variable_projection import shapes_of_data
from lieid_casadi.model import Model

Progress = Callable[[str, float], None]
ROUNDS = 30  # largest number of iterations
SETTLED = 1e-6  # relative change of the predicted torque at convergence


@dataclass(frozen=True, eq=False)
class FitState:
    """Result of one iteration.

    Attributes
    ----------
    shapes : (s,)
    rows : Rows
        At these shapes, and at the load predicted by the preceding iteration.
    weighting : Weighting
    solution : LeastSquaresSolution
    parameters : (10 n + m,)
        Link parameters and effect coefficients that give ``solution.values``.
    """

    shapes: Array
    rows: Rows
    weighting: Weighting
    solution: LeastSquaresSolution
    parameters: Array


@dataclass(frozen=True, eq=False)
class ShapeStart:
    """Values to start from, near the solution.

    Attributes
    ----------
    values : (s,)
        Shape parameters; NaN for those that are to be taken from the training recordings.
    held : bool
        Whether they stay fixed.
    parameters : (10 n + m,), optional
        Link parameters and effect coefficients that give the first load; by default it is zero.
    """

    values: Array
    held: bool = False
    parameters: Array | None = None


def fixed_point(
    design: Design, method: str, report: Progress, start: ShapeStart | None = None
) -> tuple[FitState, bool]:
    """Alternate linear fit, shapes and load until the predicted torque converges.

    Parameters
    ----------
    design : Design
    method : {"ols", "wls", "robust"}
    report : callable
        Called with a stage's name and the fraction done.
    start : ShapeStart, optional
        Without it, shapes are searched over their whole range.

    Returns
    -------
    FitState
        Of the last iteration.
    bool
        Whether it converged.
    """
    model = design.model
    estimator = ESTIMATORS[method]
    start, searched = start or ShapeStart(model.initial_shapes), start is not None
    shapes, links = _with_data_ranges(design, start), start.parameters
    iterate = bool(varying_columns(model).any())
    loaded = any("load" in p.effect.signals for p in model.placements)
    if any(isinstance(p.effect, ArmEffect) and p.effect.shapes for p in model.placements):
        # a fit without the effect is biased by it; the nominal bodies are nearer to the arm
        loaded, links = True, nominal_parameters(model) if model.robot.has_inertia else None
    before: Array | None = None
    for round_ in range(ROUNDS):
        rows = design.rows(shapes, links)
        weighting = estimator(rows)
        # shapes of load-dependent effects need a load first
        if (
            any(s.fitted for s in model.shapes)
            and not start.held
            and not (loaded and links is None)
        ):
            shapes = fit_shapes(design, shapes, links, weighting.noise, search=not searched)
            searched = True
            rows = design.rows(shapes, links)
            weighting = estimator(rows)
        solution = solve(weighting.factor)
        parameters = model.base.lift(solution.values, nominal_parameters(model))
        state = FitState(shapes, rows, weighting, solution, parameters)
        if not iterate:
            return state, weighting.converged
        links = parameters
        predicted = rows.predicted(solution.values)
        if before is not None and has_settled(predicted, before):
            return state, weighting.converged
        before = predicted
        report("regress", 0.3 + 0.6 * (round_ + 1) / ROUNDS)
    return state, False


def _with_data_ranges(design: Design, start: ShapeStart) -> Array:
    """Return the shapes (s,) to start from, with those that the recordings give."""
    data = shapes_of_data(design.model, design.segments)
    given = np.isnan(data) | (start.held & np.isfinite(start.values))
    return np.where(given, start.values, data)


def nominal_parameters(model: Model) -> Array:
    """Return nominal link parameters (zero if not stated) and zero coefficients (10 n + m,)."""
    links = model.robot.link_parameters if model.robot.has_inertia else np.zeros(10 * model.n)
    return np.concatenate([links, np.zeros(len(model.columns))])


def has_settled(predicted: Array, before: Array) -> bool:
    """Return whether two iterations predict the same torque."""
    return bool(np.linalg.norm(predicted - before) <= SETTLED * np.linalg.norm(predicted))
