"""Linear least squares on triangular factors: scaled columns and SVD, no normal matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from lieid_casadi.compiled.triangular_factors import Triangle, triangular
from lieid_casadi.errors import IdentificationError
from lieid_casadi.identification.regression.rows import Rows

Array = NDArray[np.float64]
RANK_TOLERANCE = 1e-9  # of scaled columns; below it a direction is not excited
NAMED_SHARE = 0.3  # of the largest component of a direction: smaller ones are not named
MOST_NAMED = 4


@dataclass(frozen=True, eq=False)
class Factor:
    """Triangular factor of [matrix | torque], sufficient for least squares.

    Attributes
    ----------
    r : (p + 1, p + 1)
        Upper triangular; ‖matrix·β − torque‖ = ‖r·[β; −1]‖ for every β.
    rows : int
        Number of rows that it was computed from.
    """

    r: Array
    rows: int

    def misfit(self, values: Array) -> float:
        """Return the sum of squared residuals at values (p,)."""
        return float(np.sum((self.r[:, :-1] @ values - self.r[:, -1]) ** 2))


@dataclass(frozen=True, eq=False)
class LeastSquaresSolution:
    """Result of a linear least-squares problem.

    Attributes
    ----------
    values : (p,)
        Of minimum norm (in scaled columns) along directions that are not excited.
    unit_covariance : (p, p)
        (XᵀX)⁻¹ of the rows, without directions that are not excited.
    unexcited : tuple of (p,)
        Directions in which the values can be changed without changing the residual.
    """

    values: Array
    unit_covariance: Array
    unexcited: tuple[Array, ...]


def joint_factors(rows: Rows, weights: Sequence[Array] | None = None) -> list[Factor]:
    """Return one factor per joint, in all p columns.

    Parameters
    ----------
    rows : Rows
    weights : sequence of (R,), optional
        Multiply the rows of each joint; 1 if left out.

    Raises
    ------
    IdentificationError
        An entry that is not finite.
    """
    if weights is None and rows.unweighted is not None:
        return rows.unweighted
    triangles = [Triangle(len(columns) + 1) for columns in rows.columns]
    for part, where in rows.chunks():
        for j, (joint, triangle) in enumerate(zip(part.joints, triangles, strict=True)):
            weight = None if weights is None else weights[j][where[j]]
            triangle.add(joint.matrix, joint.torque, weights=weight)
    for j, triangle in enumerate(triangles):
        if not np.isfinite(triangle.r).all():
            raise IdentificationError(
                f"joint {j + 1}: a column of the regression is not finite at some sample; "
                "check the formulas of the effects on this joint"
            )
    factors = [
        widened(triangle.r, columns, rows.count, int(length))
        for triangle, columns, length in zip(triangles, rows.columns, rows.lengths, strict=True)
    ]
    if weights is None:
        rows.unweighted = factors
    return factors


def widened(small: Array, columns: NDArray[np.integer], p: int, rows: int) -> Factor:
    """Return a factor of some columns and the torque as one of all p columns.

    Parameters
    ----------
    small : (k, c + 1)
    columns : (c,) int
        Positions among the p columns.
    p : int
    rows : int
        Number of rows that the factor was computed from.
    """
    wide = np.zeros((len(small), p + 1))
    wide[:, [*columns, p]] = small
    return Factor(wide, rows)


def combine(factors: Sequence[Factor], weights: Sequence[float] | Array) -> Factor:
    """Return the factor of all factors' rows, each factor multiplied by its weight."""
    triangle = Triangle(factors[0].r.shape[1])
    for factor, weight in zip(factors, weights, strict=True):
        triangle.add(factor.r * weight)
    return Factor(triangle.r, sum(f.rows for f in factors))


def solve(factor: Factor) -> LeastSquaresSolution:
    """Return the least-squares solution, of minimum norm where it is not unique."""
    r, z = factor.r[:, :-1], factor.r[:, -1]
    scale = np.linalg.norm(r, axis=0)
    scale[scale == 0.0] = 1.0
    u, sizes, vt = np.linalg.svd(r / scale, full_matrices=False)
    excited = sizes > RANK_TOLERANCE * sizes[0] if sizes[0] > 0 else np.zeros(len(sizes), bool)
    inverse = (vt[excited].T / sizes[excited]) / scale[:, None]
    values = inverse @ (u[:, excited].T @ z)
    unexcited = tuple(direction / scale for direction in vt[~excited])
    return LeastSquaresSolution(values, inverse @ inverse.T, unexcited)


def independent_fraction(factor: Factor) -> Array:
    """Return the part of each column's norm (p,) that the other columns do not span.

    Frisch-Waugh-Lovell: 1 / (‖column‖ · ‖row of the inverse factor‖).
    """
    r = factor.r[:, :-1]
    norms = np.linalg.norm(r, axis=0)
    safe = np.where(norms > 0, norms, 1.0)
    square = triangular(r / safe)
    diagonal = np.abs(np.diag(square))
    if len(square) < r.shape[1] or diagonal.min(initial=1.0) < 1e-14:
        square = square + 0.0
        np.fill_diagonal(square, np.where(diagonal < 1e-14, 1e-14, np.diag(square)))
    inverse = solve_triangular(square[: r.shape[1]], np.eye(r.shape[1]))
    return np.where(norms > 0, 1.0 / np.linalg.norm(inverse, axis=1), 0.0)


def name_direction(direction: Array, labels: Sequence[str]) -> str:
    """Return the parameters that dominate a direction, as in ``+0.71 Ixx5 -0.71 Iyy5``.

    Parameters
    ----------
    direction : (p,)
    labels : sequence of str
        Names of the p parameters.
    """
    unit = direction / np.linalg.norm(direction)
    order = np.argsort(-np.abs(unit))
    large = [k for k in order if abs(unit[k]) >= NAMED_SHARE * abs(unit[order[0]])]
    terms = [f"{unit[k]:+.2g} {labels[k]}" for k in large[:MOST_NAMED]]
    return " ".join(terms)
