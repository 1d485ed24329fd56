"""Least squares in coefficients and shape parameters by variable projection.

The model ``target ≈ fixed·a + columns(s)·c`` is linear in a and c and nonlinear in the shapes s.
For given shapes the coefficients follow by linear least squares, so that only the shapes are
searched: Golub & Pereyra, SIAM J. Numer. Anal. 1973, with the Jacobian of Kaufman, BIT 1975.
Columns that do not depend on the shapes are projected out once (Frisch-Waugh-Lovell theorem).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.effects.effect import DataRange, Shape
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.model import Model, Parameter
from lieid_casadi.recording import Processed

AT_BOUND = 1e-3  # of the range: a shape nearer to its end counts as at the bound
TAIL = 0.5  # percent of the samples beyond either end of the range of a signal


@dataclass(frozen=True, eq=False)
class ShapeRange:
    """Bounds (s,) of shape parameters, searched by their place in the range, 0 to 1.

    The place is logarithmic where the lower bound is above zero, linear elsewhere.
    """

    lower: Array
    upper: Array

    @classmethod
    def of(cls, parameters: Sequence[Shape | Parameter]) -> ShapeRange:
        """Return the ranges of parameters."""
        return cls(
            np.array([p.lower for p in parameters], dtype=float),
            np.array([p.upper for p in parameters], dtype=float),
        )

    def place(self, shapes: Array) -> Array:
        """Return the places (…, s) of shapes in their ranges."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.log(shapes / self.lower) / self._decades
        linear = (shapes - self.lower) / (self.upper - self.lower)
        return np.where(self._logarithmic, ratio, linear)

    def shapes(self, place: Array) -> Array:
        """Return the shapes (…, s) at places in their ranges."""
        start = np.where(self._logarithmic, self.lower, 1.0)
        logarithmic = start * np.exp(place * self._decades)
        linear = self.lower + place * (self.upper - self.lower)
        return np.where(self._logarithmic, logarithmic, linear)

    def slope(self, shapes: Array) -> Array:
        """Return ∂shape/∂place (s,)."""
        return np.where(self._logarithmic, shapes * self._decades, self.upper - self.lower)

    def at_bound(self, shapes: Array) -> Mask:
        """Mark the shapes (s,) at an end of their range."""
        place = self.place(shapes)
        return np.asarray(np.minimum(place, 1.0 - place) < AT_BOUND)

    @cached_property
    def _logarithmic(self) -> Mask:
        return np.asarray(self.lower > 0.0)

    @cached_property
    def _decades(self) -> Array:
        safe = np.where(self._logarithmic, self.lower, 1.0)
        return np.where(self._logarithmic, np.log(np.maximum(self.upper, safe) / safe), 1.0)


def shapes_of_data(model: Model, segments: Sequence[Processed]) -> Array:
    """Return the shape parameters (s,) that the training recordings give, NaN for fitted ones.

    The ends of a signal's range are percentiles over all segments. The range of τ_load, which
    depends on the fit, is that of the measured torque.
    """
    every = ((p.joint, shape.data) for p in model.placements for shape in p.effect.shapes)
    ends = [np.nan if data is None else _end(data, joint, segments) for joint, data in every]
    return np.array(ends, dtype=float)


def signal_of(data: DataRange, joint: int, segments: Sequence[Processed]) -> Array | None:
    """Return the signal (K,) of a range over all segments; None if it was not measured."""
    name = "tau" if data.signal == "load" else data.signal
    of_all = [getattr(segment, name) for segment in segments]
    if any(values is None for values in of_all):
        return None
    return np.concatenate([x[:, joint if data.joint is None else data.joint] for x in of_all])


def _end(data: DataRange, joint: int, segments: Sequence[Processed]) -> float:
    values = signal_of(data, joint, segments)
    if values is None:
        return 0.0
    if data.end == "size":
        return float(np.percentile(np.abs(values), 100.0 - TAIL))
    return float(np.percentile(values, TAIL if data.end == "low" else 100.0 - TAIL))


STEP = 1e-5  # of a shape's range, for finite differences
RANK_TOLERANCE = 1e-10  # of scaled columns
INSIDE = 1e-6  # of the range: a start at a bound is moved inside by this


@dataclass(frozen=True, eq=False)
class ProjectedSolution:
    """Linear least-squares solution at given shapes."""

    coefficients: Array  # (v,): of the columns that depend on the shapes
    residual: Array  # (R,): target minus fitted values
    basis: Array  # (R, k): orthonormal basis of those columns whose coefficients are not at a bound


@dataclass(frozen=True, eq=False)
class SeparableProblem:
    """Weighted least-squares problem that is linear in all parameters but the shapes."""

    columns: Callable[[Array], Array]  # shapes (s,) to weighted columns (R, v)
    target: Array  # (R,): weighted
    ranges: ShapeRange  # of the s shapes
    bounds: tuple[Array, Array] | None = None  # lower and upper bounds of the coefficients
    #: columns whose norm is at most this part of the largest get the coefficient zero
    negligible: float = 0.0

    def solve(self, shapes: Array) -> ProjectedSolution:
        """Return the best coefficients at given shapes (s,)."""
        target, columns = self.target, self.columns(shapes)
        scale = np.linalg.norm(columns, axis=0)
        scale[scale <= self.negligible * scale.max(initial=0.0)] = np.inf
        basis, triangle = np.linalg.qr(columns / scale)
        reduced = basis.T @ target
        free = np.linalg.lstsq(triangle, reduced, rcond=RANK_TOLERANCE)[0] / scale
        lower, upper = self.bounds or (-np.inf, np.inf)
        if np.all((free >= lower) & (free <= upper)):
            return ProjectedSolution(free, target - basis @ reduced, basis)
        return self._solve_bounded(columns, target, np.where(np.isinf(scale), 1.0, scale))

    def cost(self, shapes: Array) -> float:
        """Return the sum of squared residuals at given shapes (s,)."""
        return float(np.sum(self.solve(shapes).residual ** 2))

    def jacobian(self, shapes: Array, solution: ProjectedSolution) -> Array:
        """Return ∂residual/∂shapes ≈ −(1 − QQᵀ)·(∂columns/∂shapes)·c (R, s), after Kaufman."""
        slopes = forward_differences(self.columns, self.ranges, shapes, solution.coefficients)
        return np.asarray(solution.basis @ (solution.basis.T @ slopes) - slopes)

    def _solve_bounded(self, columns: Array, target: Array, scale: Array) -> ProjectedSolution:
        assert self.bounds is not None
        lower, upper = self.bounds
        found = lsq_linear(columns / scale, target, (lower * scale, upper * scale))
        coefficients = np.asarray(found.x) / scale
        basis, _ = np.linalg.qr((columns / scale)[:, found.active_mask == 0])
        return ProjectedSolution(coefficients, target - columns @ coefficients, basis)


class ShapeProblem(Protocol):
    """A least-squares problem in shapes alone."""

    @property
    def ranges(self) -> ShapeRange:
        """Ranges of the shapes."""

    def solve(self, shapes: Array) -> Any:
        """Return what is known at given shapes: the ``residual``, and what `jacobian` needs."""

    def jacobian(self, shapes: Array, solution: Any) -> Array:
        """Return ∂residual/∂shapes."""


def minimize_shapes(
    problem: ShapeProblem,
    start: Array,
    *,
    xtol: float = 1e-6,
    ftol: float = 1e-8,
    max_evaluations: int = 40,
) -> Array:
    """Return shapes (s,) at a local minimum of the cost, within their ranges.

    Trust-region least squares on the places of the shapes in their ranges.
    """
    ranges = problem.ranges
    latest: dict[bytes, Any] = {}  # residual and Jacobian share one solution

    def solution(place: Array) -> Any:
        key = place.tobytes()
        if key not in latest:
            latest.clear()
            latest[key] = problem.solve(ranges.shapes(place))
        return latest[key]

    def residual(place: Array) -> Array:
        return np.asarray(solution(place).residual)

    def jacobian(place: Array) -> Array:
        shapes = ranges.shapes(place)
        return problem.jacobian(shapes, solution(place)) * ranges.slope(shapes)

    result = least_squares(
        residual,
        np.clip(ranges.place(start), INSIDE, 1.0 - INSIDE),
        jac=jacobian,
        bounds=(0.0, 1.0),
        xtol=xtol,
        ftol=ftol,
        max_nfev=max_evaluations,
    )
    return ranges.shapes(np.asarray(result.x))


def forward_differences(
    columns: Callable[[Array], Array], ranges: ShapeRange, shapes: Array, coefficients: Array
) -> Array:
    """Return ∂(columns·coefficients)/∂shapes (R, s) by forward differences."""
    here = columns(shapes) @ coefficients
    steps = STEP * ranges.slope(shapes)
    changes = [
        (columns(shapes + step * unit) @ coefficients - here) / step
        for step, unit in zip(steps, np.eye(len(shapes)), strict=True)
    ]
    return np.array(changes).reshape(len(shapes), len(here)).T


def shape_slopes(
    design: Design, shapes: Array, links: Array | None
) -> list[tuple[int, int, Indices, Array]]:
    """Return the derivatives of columns by fitted shapes.

    Of each the shape, the joint, the base columns (c,) and their derivatives (R, c) on its rows.
    """
    steps = STEP * ShapeRange.of(design.model.shapes).slope(shapes)
    fitted = [shape.fitted for shape in design.model.shapes]
    found = []
    for alike in design.alike.values():
        if any(fitted[k] for k in alike[0].shapes):
            for e, slopes in zip(alike, design.slopes(alike, shapes, steps, links), strict=True):
                own = [(i, int(k)) for i, k in enumerate(e.shapes) if fitted[k]]
                found += [(k, e.placement.joint, e.columns, slopes[:, i]) for i, k in own]
    if design.of_arm and links is not None:
        found += _slopes_along_the_arm(design, shapes, steps, links)
    return found


def _slopes_along_the_arm(
    design: Design, shapes: Array, steps: Array, links: Array
) -> list[tuple[int, int, Indices, Array]]:
    """Return those of effects along the arm: a limit of torque changes what a delay does, too."""
    here, found = design.arm_rows(shapes, links), []
    columns = np.concatenate([e.columns for e in design.of_arm])
    joints = np.array([e.placement.joint for e in design.of_arm for _ in e.columns])
    for members in _same_shape_groups(design):
        own = [k for k in members if design.model.shapes[k].fitted]
        own = [k for k in own if design.model.shapes[k].joint in joints]
        if own:
            step = np.zeros(len(shapes))
            step[own] = steps[own]
            moved = design.arm_rows(shapes + step, links, kept=False)
            for k in own:
                j = design.model.shapes[k].joint
                change = (moved[j] - here[j])[:, joints == j] / step[k]
                found.append((k, j, columns[joints == j], change))
    return found


def shape_columns(design: Design, values: Array, shapes: Array, links: Array | None) -> list[Array]:
    """Return ∂torque/∂shapes per joint (R, s), N·m per unit of each shape."""
    derivatives = [np.zeros((int(count), len(shapes))) for count in design.lengths]
    for k, j, columns, slopes in shape_slopes(design, shapes, links):
        derivatives[j][:, k] += slopes @ values[columns]
    return derivatives


def _same_shape_groups(design: Design) -> list[list[int]]:
    """Group the numbers of shapes that are one shape of one effect on several joints."""
    groups: dict[tuple[str, int], list[int]] = {}
    for slot in design.model.slots:
        for k in range(slot.shapes.start, slot.shapes.stop):
            key = slot.placement.effect.label, k - slot.shapes.start
            groups.setdefault(key, []).append(k)
    return list(groups.values())
