"""Shape parameters refined together, by variable projection on inner products.

All that a step needs are inner products of the torque, of the columns that depend on shapes, and of
their derivatives, outside the columns that depend on none (Golub, Pereyra, SIAM J. Numer. Anal.
1973; the Jacobian is that of Kaufman, BIT 1975). Columns of an effect on one joint have rows of
this joint alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import Rows
from lieid_casadi.identification.regression.resolved_shapes import resolved_range
from lieid_casadi.identification.regression.shape_scan import VANISHING, WeightedProjection
from lieid_casadi.identification.regression.variable_projection import (
    ShapeRange,
    minimize_shapes,
    shape_slopes,
)

EVALUATIONS = 3  # in a round of `fixed_point`, whose next round goes on from there


def refine_shapes(
    design: Design, rows: Rows, start: Array, links: Array | None, noise: Array
) -> Array:
    """Return the shapes (s,) two steps nearer to a local minimum of the weighted residual.

    ``rows`` are those of the design at any shapes and the load by ``links`` (10 n,), None means no
    load; they are weighted by the inverse of the ``noise`` (n,). Shapes that are not fitted stay as
    they are.
    """
    problem = RefinementProblem(design, rows, start, links, noise)
    return problem.every(minimize_shapes(problem, start[problem.free], max_evaluations=EVALUATIONS))


@dataclass(frozen=True, eq=False)
class _Linearized:
    """Residual (s + 1,) and Jacobian (s + 1, s) with the inner products of those of all rows."""

    residual: Array
    jacobian: Array


class RefinementProblem:
    """The weighted regression as a least-squares problem in the fitted shapes."""

    def __init__(
        self, design: Design, rows: Rows, start: Array, links: Array | None, noise: Array
    ) -> None:
        fitted = np.array([shape.fitted for shape in design.model.shapes], dtype=bool)
        self._design, self._start, self._links = design, start, links
        self.free, whole = np.flatnonzero(fitted), resolved_range(design)
        self.ranges = ShapeRange(whole.lower[self.free], whole.upper[self.free])
        moving = [e for e in design.effects if e.of_arm or fitted[e.shapes].any()]
        #: places, among the varying columns of the design, of those that depend on fitted shapes
        self._at = np.concatenate([e.at for e in moving])
        self._fixed = WeightedProjection(rows, design.varying[self._at], noise)

    def every(self, free: Array) -> Array:
        """Return all shapes of the model from those that are fitted."""
        shapes = self._start.copy()
        shapes[self.free] = free
        return shapes

    def jacobian(self, shapes: Array, solution: _Linearized) -> Array:
        """See `minimize_shapes`."""
        return solution.jacobian

    def solve(self, shapes: Array) -> _Linearized:
        """Return the residual and the Jacobian at shapes (s,)."""
        every, design, count = self.every(shapes), self._design, len(self._at)
        slopes = shape_slopes(design, every, self._links)
        shape_of = [k for k, _, columns, _ in slopes for _ in columns]
        column_of = [int(c) for _, _, columns, _ in slopes for c in columns]
        size, first = count + len(shape_of) + 1, count  # columns, derivatives, torque
        numbers = [[np.array([size - 1])] for _ in range(design.model.n)]
        matrices = [[self._fixed.residual(j)[:, None]] for j in range(design.model.n)]
        for _, j, columns, values in slopes:
            numbers[j].append(np.arange(first, first + len(columns)))
            matrices[j].append(values * self._fixed.weights[j])
            first += len(columns)
        gram, along = np.zeros((size, size)), np.zeros((self._fixed.count, size))
        for j, rows in enumerate(design.varying_rows(every, self._links)):
            own = rows[:, self._at] * self._fixed.weights[j]
            here = np.flatnonzero(own.any(axis=0))
            place = np.concatenate([*numbers[j], here])
            matrix = np.column_stack([*matrices[j], own[:, here]])
            gram[np.ix_(place, place)] += matrix.T @ matrix
            along[:, place] += self._fixed.along(j, matrix)
        scale = np.sqrt(np.maximum(np.diag(gram)[:count], 1e-300))
        gram -= along.T @ along
        inverse = _inverse(gram[:count, :count], scale)
        coefficients = inverse @ gram[:count, -1]
        position = {int(c): coefficients[i] for i, c in enumerate(design.varying[self._at])}
        combined = np.zeros((size, len(self.free) + 1))  # derivatives of torque, and the torque
        at = np.searchsorted(self.free, shape_of)
        combined[np.arange(count, size - 1), at] = [position[c] for c in column_of]
        combined[-1, -1] = 1.0
        crossed = gram[:count] @ combined
        outside = combined.T @ gram @ combined - crossed.T @ inverse @ crossed
        scale = np.sqrt(np.maximum(np.diag(outside), 1e-300))
        sizes, axes = np.linalg.eigh(outside / scale / scale[:, None])
        root = np.sqrt(np.maximum(sizes, 0.0))[:, None] * axes.T * scale
        return _Linearized(root[:, -1], -root[:, :-1])


def _inverse(gram: Array, scale: Array) -> Array:
    """Return the inverse of inner products of columns with given norms, 0 if dependent."""
    sizes, axes = np.linalg.eigh(gram / scale / scale[:, None])
    used = sizes > VANISHING
    return np.asarray((axes[:, used] / sizes[used]) @ axes[:, used].T / scale / scale[:, None])
