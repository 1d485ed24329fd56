"""Shape parameters by variable projection with bounds.

For given shapes the linear parameters follow by least squares, so that only the shapes are
searched: Golub & Pereyra, SIAM J. Numer. Anal. 1973, with Kaufman's Jacobian. The columns that
do not depend on shapes are projected away once (Frisch-Waugh-Lovell).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.shape_range import ShapeRange

Array = NDArray[np.float64]
GRID = 17  # values tried over each shape's range
DESCENTS = 3  # best values of the grid that a descent starts from
STEP = 1e-5  # of a shape's range, for the columns' derivative


def fit_shapes(
    design: Design, start: Array, links: Array | None, noise: Array, *, search: bool
) -> Array:
    """Return the shapes (s,) that minimize the weighted residual.

    Parameters
    ----------
    start : (s,)
    links : (10 n,) or None
        Link parameters that give the load.
    noise : (n,)
        Weights are 1/noise per joint.
    search : bool
        Whether to try values over the whole range first; the cost can have several minima.
    """
    ranges = ShapeRange.of(design.model.shapes)
    problem = _Reduced(design, links, noise)
    starts = _starts(problem, ranges) if search else [start]
    descents = [_descend(problem, ranges, start) for start in starts]
    return min(descents, key=lambda shapes: problem.cost(shapes))


def shape_columns(design: Design, values: Array, shapes: Array, links: Array | None) -> list[Array]:
    """Return ∂torque/∂shape per joint (R, s) at given linear values (p,)."""
    coefficients = values[design.varying]
    here = design.varying_rows(shapes, links)
    steps = STEP * ShapeRange.of(design.model.shapes).slope(shapes)
    derivatives = [np.zeros((len(rows), len(shapes))) for rows in here]
    for members in _slots(design):
        step = np.zeros(len(shapes))
        step[members] = steps[members]
        moved = design.varying_rows(shapes + step, links)
        for k in members:
            j = design.model.shapes[k].joint
            own = design.columns_of_shape(k)
            change = (moved[j] - here[j])[:, own] / step[k]
            derivatives[j][:, k] = change @ coefficients[own]
    return derivatives


@dataclass(frozen=True, eq=False)
class _Solved:
    """Linear part at given shapes: coefficients of the varying columns and the residual."""

    coefficients: Array
    residual: Array
    basis: Array


class _Reduced:
    """The weighted regression with the columns that do not vary projected away."""

    def __init__(self, design: Design, links: Array | None, noise: Array) -> None:
        self.design, self.links, self.noise = design, links, noise
        rows = design.rows(design.model.initial_shapes, links)
        self.ends = np.cumsum([len(joint.torque) for joint in rows.joints])[:-1]
        matrix = np.zeros((sum(len(joint.torque) for joint in rows.joints), rows.count))
        for block, joint in zip(np.split(matrix, self.ends), rows.joints, strict=True):
            block[:, joint.columns] = joint.matrix
        fixed = np.ones(rows.count, dtype=bool)
        fixed[design.varying] = False
        weighted = self._weighted([m[:, fixed] for m in np.split(matrix, self.ends)])
        scale = np.linalg.norm(weighted, axis=0)
        self.fixed, _ = np.linalg.qr(weighted / np.where(scale > 0.0, scale, 1.0))
        torque = self._weighted([joint.torque for joint in rows.joints])
        self.torque = torque - self.fixed @ (self.fixed.T @ torque)

    def _weighted(self, per_joint: list[Array]) -> Array:
        return np.concatenate([x / s for x, s in zip(per_joint, self.noise, strict=True)])

    def solve(self, shapes: Array) -> _Solved:
        columns = self._weighted(self.design.varying_rows(shapes, self.links))
        columns = columns - self.fixed @ (self.fixed.T @ columns)
        scale = np.linalg.norm(columns, axis=0)
        scale[scale == 0.0] = 1.0
        basis, triangle = np.linalg.qr(columns / scale)
        reduced = basis.T @ self.torque
        coefficients = np.linalg.lstsq(triangle, reduced, rcond=1e-10)[0] / scale
        return _Solved(coefficients, self.torque - basis @ reduced, basis)

    def cost(self, shapes: Array) -> float:
        return float(np.sum(self.solve(shapes).residual ** 2))

    def joint_costs(self, shapes: Array) -> Array:
        parts = np.split(self.solve(shapes).residual, self.ends)
        return np.array([np.sum(part**2) for part in parts])

    def jacobian(self, shapes: Array) -> Array:
        """Return ∂residual/∂shapes ≈ −(1 − QQᵀ)·(∂matrix/∂shape)·β (Kaufman)."""
        solved = self.solve(shapes)
        values = np.zeros(self.design.model.base.count)
        values[self.design.varying] = solved.coefficients
        slopes = self._weighted(shape_columns(self.design, values, shapes, self.links))
        for q in (self.fixed, solved.basis):
            slopes = slopes - q @ (q.T @ slopes)
        return np.asarray(-slopes)


def _descend(problem: _Reduced, ranges: ShapeRange, start: Array) -> Array:
    def residual(place: Array) -> Array:
        return problem.solve(ranges.shapes(place)).residual

    def jacobian(place: Array) -> Array:
        shapes = ranges.shapes(place)
        return problem.jacobian(shapes) * ranges.slope(shapes)

    result = least_squares(
        residual,
        np.clip(ranges.place(start), 1e-6, 1.0 - 1e-6),
        jac=jacobian,
        bounds=(0.0, 1.0),
        xtol=1e-6,
        ftol=1e-8,
        max_nfev=40,
    )
    return ranges.shapes(np.asarray(result.x))


def _starts(problem: _Reduced, ranges: ShapeRange) -> list[Array]:
    """Return starts from a grid over the ranges: first each joint's best values, then next best.

    Shapes of one kind on several joints touch different rows and are tried at once.
    """
    design = problem.design
    starts = np.tile(design.model.initial_shapes, (DESCENTS, 1))
    places = (np.arange(GRID) + 0.5) / GRID
    for members in _slots(design):
        grid = []
        for place in places:
            trial = starts[0].copy()
            trial[members] = ranges.shapes(np.full(len(trial), place))[members]
            grid.append(problem.joint_costs(trial))
        for k in members:
            costs = np.array(grid)[:, design.model.shapes[k].joint]
            for rank, index in enumerate(_minima(costs)[:DESCENTS]):
                starts[rank:, k] = ranges.shapes(np.full(starts.shape[1], places[index]))[k]
    return list(np.unique(starts, axis=0))


def _minima(costs: Array) -> list[int]:
    """Return the indices of local minima, lowest first."""
    padded = np.concatenate([[np.inf], costs, [np.inf]])
    lower = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])
    return sorted(np.flatnonzero(lower).tolist(), key=lambda k: float(costs[k]))


def _slots(design: Design) -> list[list[int]]:
    """Group shapes of one kind over joints."""
    groups: dict[tuple[str, int], list[int]] = {}
    k = 0
    for p in design.model.placements:
        for position in range(len(p.effect.shapes)):
            groups.setdefault((p.effect.label, position), []).append(k)
            k += 1
    return list(groups.values())
