"""Weights of the rows: none, by joint noise, or robust against outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification.regression.least_squares import (
    Factor,
    combine,
    joint_factors,
    solve,
)
from lieid_casadi.identification.regression.rows import Rows

Array = NDArray[np.float64]
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
