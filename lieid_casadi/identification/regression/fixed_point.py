"""Fixed-point iteration over linear parameters, shape parameters and load."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.effects import ArmEffect
from lieid_casadi.effects.command_delay import CommandDelay
from lieid_casadi.identification.regression.design_matrix import Design, varying_columns
from lieid_casadi.identification.regression.least_squares import (
    ESTIMATORS,
    LeastSquaresSolution,
    Rows,
    Weighting,
    ols,
    solve,
)
from lieid_casadi.identification.regression.priors import with_priors
from lieid_casadi.identification.regression.resolved_shapes import resolved_range
from lieid_casadi.identification.regression.shape_refinement import refine_shapes
from lieid_casadi.identification.regression.shape_scan import ShapeScan
from lieid_casadi.identification.regression.variable_projection import shapes_of_data
from lieid_casadi.model import Model

Progress = Callable[[str, float], None]
Estimator = Callable[[Rows, Array], Weighting]
ROUNDS = 30  # largest number of iterations
MOST_SCANS = 6  # of all shapes over their ranges
STEEPEST = 0.9  # slope of a step to the next one, in an extrapolation
SETTLED = 1e-6  # relative change of the predicted torque at convergence


@dataclass(frozen=True, eq=False)
class FitState:
    """Result of one iteration."""

    shapes: Array  # (s,)
    rows: Rows  # at these shapes, and at the load predicted by the preceding iteration
    weighting: Weighting
    solution: LeastSquaresSolution
    #: (10 n + m,): link parameters and effect coefficients that give ``solution.values``
    parameters: Array
    scan: ShapeScan | None = None  # by which the shapes were found; None if they were held


def fixed_point(
    design: Design, method: str, report: Progress, held_shapes: Array | None = None
) -> tuple[FitState, bool]:
    """Alternate linear fit, shapes and load until the predicted torque converges.

    Shapes are first scanned over their whole ranges, then refined together in every round. At
    convergence they are scanned again; the fit is done when the scan finds nothing better.
    """
    model = design.model
    links, shapes = None, shapes_of_data(model, design.segments)
    values = model.initial_shapes if held_shapes is None else held_shapes
    given = np.isnan(shapes) | (held_shapes is not None and np.isfinite(values))
    shapes = np.where(given, values, shapes)
    searched = held_shapes is None and any(s.fitted for s in model.shapes)
    search = _Search(design) if searched else None
    iterate = bool(varying_columns(model).any())
    loaded = any("load" in p.effect.signals for p in model.placements)
    if any(isinstance(p.effect, ArmEffect) and p.effect.shapes for p in model.placements):
        # a fit without the effect is biased by it; the nominal bodies are nearer to the arm
        loaded, links = True, nominal_parameters(model) if model.robot.has_inertia else None
    before, steps = None, DelaySteps(model)
    state = _state(design, ESTIMATORS[method], shapes, links, np.ones(model.n))
    for round_ in range(ROUNDS):
        # shapes of load-dependent effects need a load first
        if search is not None and not (loaded and links is None):
            state = search.improved(state, links, ESTIMATORS[method])
        if not iterate:
            return state, state.weighting.converged
        predicted = state.rows.predicted(state.solution.values)
        settled = before is not None and has_settled(predicted, before)
        if settled and (search is None or search.confirms(state, links)):
            scan = None if search is None else search.scan
            return replace(state, scan=scan), state.weighting.converged
        before, links = predicted, steps.next(links, state.parameters)
        state = _state(design, ESTIMATORS[method], state.shapes, links, state.weighting.noise)
        report("regress", 0.3 + 0.6 * (round_ + 1) / ROUNDS)
    return state, False


class _Search:
    """Shapes of one design: scanned over their ranges where nothing is known, else refined."""

    def __init__(self, design: Design) -> None:
        self._design = design
        self.scan = ShapeScan(design, resolved_range(design))
        self._start: Array | None = None
        self._scans = 0

    def improved(self, state: FitState, links: Array | None, estimator: Estimator) -> FitState:
        """Return the state at better shapes."""
        noise, shapes = state.weighting.noise, self._start
        if not self._scans:
            shapes = self.scan.found(state.rows, state.shapes, links, noise, afresh=True)
            self._scans = 1
        self._start = None
        start = state.shapes if shapes is None else shapes
        shapes = refine_shapes(self._design, state.rows, start, links, noise)
        return _state(self._design, estimator, shapes, links, noise)

    def confirms(self, state: FitState, links: Array | None) -> bool:
        """Whether no value of any one effect lowers the cost; keeps a better one otherwise."""
        if self._scans > MOST_SCANS:
            return True
        noise = state.weighting.noise
        shapes = self.scan.found(state.rows, state.shapes, links, noise, afresh=False)
        self._scans += 1
        if np.array_equal(shapes, state.shapes):
            return True
        self._start = shapes
        return False


def _state(
    design: Design, estimator: Estimator, shapes: Array, links: Array | None, noise: Array
) -> FitState:
    """Return the linear fit at given shapes and load; weights are iterated from a noise (n,)."""
    rows = design.linearized(shapes, links)
    weighting = estimator(rows, noise)
    solution = solve(weighting.factor)
    if estimator is not ols:  # whose rows are not in units of the noise
        weighting = replace(weighting, factor=with_priors(weighting.factor, design))
        solution = replace(solve(weighting.factor), unexcited=solution.unexcited)
    parameters = design.model.base.lift(solution.values, nominal_parameters(design.model))
    return FitState(shapes, rows, weighting, solution, parameters)


def nominal_parameters(model: Model) -> Array:
    """Return nominal link parameters (zero if not stated) and zero coefficients (10 n + m,)."""
    links = model.robot.link_parameters if model.robot.has_inertia else np.zeros(10 * model.n)
    return np.concatenate([links, np.zeros(len(model.columns))])


class DelaySteps:
    """Steps of the delays of commands to the next iteration, by Wegstein's method.

    The column of a delay is its whole change of torque, not the derivative, so that the solutions
    of the linear fit approach the delay by a part of the distance that is nearly constant: the
    secant through the last two iterations extrapolates it (Wegstein, Comm. ACM 1958).
    """

    def __init__(self, model: Model) -> None:
        self._own = 10 * model.n + np.flatnonzero(
            [
                isinstance(p.effect, CommandDelay)
                for p in model.placements
                for _ in p.effect.coefficients
            ]
        )
        self._last: tuple[Array, Array] | None = None

    def next(self, given: Array | None, found: Array) -> Array:
        """Return parameters from those of an iteration and those that its linear fit found."""
        if given is None or not len(self._own):
            return found
        x, y, last = given[self._own], found[self._own], self._last
        self._last, parameters = (x, y), found.copy()
        if last is not None:
            way = x - last[0]
            slope = np.divide(y - last[1], way, out=np.zeros(len(x)), where=way != 0.0)
            slope = np.clip(slope, -STEEPEST, STEEPEST)
            parameters[self._own] = np.maximum(x + (y - x) / (1.0 - slope), 0.0)
        return parameters


def has_settled(predicted: Array, before: Array) -> bool:
    """Return whether two iterations predict the same torque."""
    return bool(np.linalg.norm(predicted - before) <= SETTLED * np.linalg.norm(predicted))
