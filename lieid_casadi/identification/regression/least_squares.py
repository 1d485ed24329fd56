"""Linear least squares on triangular factors: scaled columns and SVD, no normal matrix.

Rows have no weights (`ols`), those of each joint's noise (`wls`), or further ones against outliers
(`robust`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from lieid_casadi.arrays import Array
from lieid_casadi.compiled.triangular_factors import Triangle, triangular
from lieid_casadi.dynamics.base_parameters import BaseParameters
from lieid_casadi.errors import IdentificationError
from lieid_casadi.identification.regression.rows import Rows

RANK_TOLERANCE = 1e-9  # of scaled columns; below it a direction is not excited
VANISHING = 1e-100  # norm of a column that counts as zero: its inverse squared must be finite
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
    scale[scale < VANISHING] = 1.0
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


@dataclass(frozen=True)
class Conditioning:
    """Singular values of the stacked full regressor [Y, effect columns] (SI, unscaled).

    ``condition_number`` is σ₁/σ_r with r the structural rank; ``beyond`` is σ_{r+1}, zero up
    to rounding errors.
    """

    largest: float
    smallest: float
    beyond: float

    @property
    def condition_number(self) -> float:
        """σ₁/σ_r, infinite if the recording does not excite a structural direction."""
        return self.largest / self.smallest if self.smallest > 0.0 else float("inf")


def conditioning(unweighted: Factor, base: BaseParameters) -> Conditioning:
    """Return the conditioning of the full regressor, which is base columns · combination.

    Parameters
    ----------
    unweighted : Factor
        Of the base columns.
    """
    full = unweighted.r[:, :-1] @ base.combination
    sizes = np.linalg.svd(full, compute_uv=False)
    rank = base.count
    beyond = float(sizes[rank]) if len(sizes) > rank else 0.0
    smallest = float(sizes[rank - 1]) if len(sizes) >= rank else 0.0
    return Conditioning(float(sizes[0]), smallest, beyond)


ITERATIONS = 50
CONVERGED = 1e-4
HUBER = 1.345  # 95 % efficiency under normal noise
SMALLEST_NOISE = 1e-12


@dataclass(frozen=True, eq=False)
class Weighting:
    """Weighted rows of an estimator.

    Attributes
    ----------
    factor : Factor
        Of all rows, weighted.
    noise : (n,)
        Residual standard deviation per joint, N·m.
    rows : tuple of (R,)
        Weight of each row of each joint.
    converged : bool
    """

    factor: Factor
    noise: Array
    rows: tuple[Array, ...]
    converged: bool


def ols(rows: Rows) -> Weighting:
    """Ordinary least squares: the same weight for every row."""
    factors = joint_factors(rows)
    factor = combine(factors, np.ones(len(factors)))
    noise = _noise(factors, solve(factor).values, rows)
    return Weighting(factor, noise, _row_weights(rows, np.ones(len(factors))), True)


def wls(rows: Rows) -> Weighting:
    """Weighted least squares: rows divided by their joint's residual noise, iterated."""
    factors = joint_factors(rows)
    noise, converged = np.ones(len(factors)), False
    for _ in range(ITERATIONS):
        factor = combine(factors, 1.0 / noise)
        fresh = _noise(factors, solve(factor).values, rows)
        converged = bool(np.all(np.abs(fresh - noise) <= CONVERGED * noise))
        noise = fresh
        if converged:
            break
    return Weighting(
        combine(factors, 1.0 / noise), noise, _row_weights(rows, 1.0 / noise), converged
    )


def robust(rows: Rows) -> Weighting:
    """Huber's M-estimator by iteratively reweighted least squares; joint noise from the MAD."""
    start = wls(rows)
    values, converged = solve(start.factor).values, False
    weights, noise, factor = list(start.rows), start.noise, start.factor
    for _ in range(ITERATIONS):
        residuals = rows.residuals(values)
        noise = np.array([max(_mad(e), SMALLEST_NOISE) if len(e) else 1.0 for e in residuals])
        # rows are multiplied by the square root of Huber's weight over the joint's noise
        weights = [
            np.sqrt(np.minimum(1.0, HUBER * s / np.maximum(np.abs(e), SMALLEST_NOISE))) / s
            for e, s in zip(residuals, noise, strict=True)
        ]
        factor = combine(joint_factors(rows, weights), np.ones(len(weights)))
        fresh = solve(factor).values
        change = np.abs(fresh - values).max(initial=0.0)
        values = fresh
        converged = bool(change <= CONVERGED * np.abs(values).max(initial=SMALLEST_NOISE))
        if converged:
            break
    return Weighting(factor, noise, tuple(weights), converged)


ESTIMATORS = {"ols": ols, "wls": wls, "robust": robust}


def _noise(factors: list[Factor], values: Array, rows: Rows) -> Array:
    """Return each joint's residual standard deviation (n,); 1 where a joint has no rows."""
    noise = []
    for factor, columns in zip(factors, rows.columns, strict=True):
        # parameters are shared between joints: each joint has its part of their number
        share = len(columns) * factor.rows / max(_uses(rows, columns), 1)
        freedom = max(factor.rows - share, 1.0)
        size = np.sqrt(factor.misfit(values) / freedom) if factor.rows else 1.0
        noise.append(max(float(size), SMALLEST_NOISE))
    return np.array(noise)


def _uses(rows: Rows, columns: NDArray[np.intp]) -> float:
    """Return the mean number of rows in which these columns appear."""
    total = np.zeros(rows.count)
    for own, length in zip(rows.columns, rows.lengths, strict=True):
        total[own] += length
    return float(np.mean(total[columns])) if len(columns) else 1.0


def _row_weights(rows: Rows, per_joint: Array) -> tuple[Array, ...]:
    return tuple(np.full(length, w) for length, w in zip(rows.lengths, per_joint, strict=True))


def _mad(residual: Array) -> float:
    return float(1.4826 * np.median(np.abs(residual - np.median(residual))))
