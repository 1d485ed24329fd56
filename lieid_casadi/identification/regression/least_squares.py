"""Equations of a regression; their least squares by scaled columns and SVD of triangular factors.

No normal matrix is formed. Rows have no weights (`ols`), those of each joint's noise (`wls`), or
further ones against outliers (`robust`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.stats import median_abs_deviation

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.compiled.triangular_factors import Triangle, triangular
from lieid_casadi.dynamics.base_parameters import BaseParameters
from lieid_casadi.errors import IdentificationError

RANK_TOLERANCE = 1e-9  # of scaled columns; below it a direction is not excited
VANISHING = 1e-100  # norm of a column that counts as zero: its inverse squared must be finite
NO_TORQUE = 1e-9  # norm of a column relative to the largest that counts as zero
NAMED_SHARE = 0.3  # of the largest component of a direction: smaller ones are not named
MOST_NAMED = 4
WEAK = 0.05  # part of a column that the others do not span: below it, its parameter is weak


@dataclass(frozen=True, eq=False)
class JointRows:
    """One joint's equations ``torque = matrix @ β[columns]``."""

    columns: Indices  # (c,): base columns that act on it: of the links from it on, of its effects
    matrix: Array  # (R, c)
    torque: Array  # (R,): N·m
    instant: Indices  # (R,): position of each row on the common time line of all segments

    def residual(self, values: Array) -> Array:
        """Return measured − predicted torque (R,)."""
        return np.asarray(self.torque - self.matrix @ values[self.columns])


@dataclass(frozen=True, eq=False)
class Rows:
    """Equations of all joints in ``count`` base columns."""

    joints: Sequence[JointRows]
    count: int
    segments: Indices  # (k + 1,): first instant of each segment, and the number of instants

    @cached_property
    def factors(self) -> list[Factor]:
        """One factor per joint of the rows without weights."""
        return joint_factors(self, [None] * len(self.joints))

    @property
    def lengths(self) -> Indices:
        """Number of rows of each joint (n,)."""
        return np.array([len(joint.torque) for joint in self.joints], dtype=np.intp)

    def residuals(self, values: Array) -> list[Array]:
        """Return measured − predicted torque per joint (R,)."""
        return [joint.residual(values) for joint in self.joints]

    def on_time_line(self, values: Array) -> Array:
        """Return the residuals (instants, n) on the common time line, NaN where there is no row."""
        line = np.full((int(self.segments[-1]), len(self.joints)), np.nan)
        for j, joint in enumerate(self.joints):
            line[joint.instant, j] = joint.residual(values)
        return line

    def predicted(self, values: Array) -> Array:
        """Return the predicted torque of all rows, one joint after another."""
        return np.concatenate([joint.matrix @ values[joint.columns] for joint in self.joints])

    def blocks(self, length: int) -> Indices:
        """Return the block of each instant; every segment begins with a new block."""
        numbers, first = np.empty(int(self.segments[-1]), dtype=np.intp), 0
        for start, end in zip(self.segments[:-1], self.segments[1:], strict=True):
            numbers[start:end] = first + np.arange(end - start) // length
            first = int(numbers[end - 1]) + 1 if end > start else first
        return numbers

    def factors_at(self, instants: Mask) -> list[Factor]:
        """Return one factor per joint of the rows at marked instants."""
        parts = []
        for joint in self.joints:
            use = instants[joint.instant]
            own = joint.matrix[use], joint.torque[use], joint.instant[use]
            parts.append(JointRows(joint.columns, *own))
        return Rows(parts, self.count, self.segments).factors


@dataclass(frozen=True, eq=False)
class Factor:
    """Triangular factor of [matrix | torque], sufficient for least squares."""

    r: Array  # (p + 1, p + 1): upper triangular; ‖matrix·β − torque‖ = ‖r·[β; −1]‖ for every β
    rows: int  # number of rows that it was computed from

    def misfit(self, values: Array) -> float:
        """Return the sum of squared residuals at values (p,)."""
        return float(np.sum((self.r[:, :-1] @ values - self.r[:, -1]) ** 2))


@dataclass(frozen=True, eq=False)
class LeastSquaresSolution:
    """Result of a linear least-squares problem."""

    values: Array  # (p,): of minimum norm (in scaled columns) along directions that are not excited
    unit_covariance: Array  # (p, p): (XᵀX)⁻¹ of the rows, without directions that are not excited
    #: directions in which the values can be changed without changing the residual
    unexcited: tuple[Array, ...]


def joint_factors(rows: Rows, weights: Sequence[Array | None]) -> list[Factor]:
    """Return one factor per joint, in all p columns; ``weights`` multiply the rows."""
    found = []
    for j, (joint, weight) in enumerate(zip(rows.joints, weights, strict=True)):
        triangle = Triangle(len(joint.columns) + 1)
        triangle.add(joint.matrix, joint.torque, weights=weight)
        if not np.isfinite(triangle.r).all():
            raise IdentificationError(
                f"joint {j + 1}: a column of the regression is not finite at some sample; "
                "check the formulas of the effects on this joint"
            )
        wide = np.zeros((len(triangle.r), rows.count + 1))
        wide[:, [*joint.columns, rows.count]] = triangle.r
        found.append(Factor(wide, len(joint.torque)))
    return found


def stacked(rows: Rows, weights: Sequence[Array] | None = None) -> Factor:
    """Return the factor of the rows of all joints, multiplied by weights."""
    factors = rows.factors if weights is None else joint_factors(rows, weights)
    return combine(factors, np.ones(len(factors)))


def combine(factors: Sequence[Factor], weights: Sequence[float] | Array) -> Factor:
    """Return the factor of all factors' rows, each factor multiplied by its weight."""
    triangle = Triangle(factors[0].r.shape[1])
    for factor, weight in zip(factors, weights, strict=True):
        triangle.add(factor.r * weight)
    return Factor(triangle.r, sum(f.rows for f in factors))


def unit_columns(matrix: Array) -> tuple[Array, Array]:
    """Return columns divided by their norms, and the norms.

    Those of columns that are zero relative to the largest one, as of a joint that stood still, are
    that of the largest, so that they stay zero.
    """
    norms = np.linalg.norm(matrix, axis=0)
    largest = float(norms.max(initial=VANISHING))
    norms[norms < max(NO_TORQUE * largest, VANISHING)] = max(largest, 1.0)
    return matrix / norms, norms


def independent_axes(
    matrix: Array, *, tolerance: float = RANK_TOLERANCE
) -> tuple[Array, Array, Array]:
    """Return an orthonormal basis U (R, r) of columns, V (p, r) with U = matrix·V, and the rest.

    The rest (p − r, p) are directions that do not change matrix·β.
    """
    scaled, scale = unit_columns(matrix)
    u, sizes, vt = np.linalg.svd(scaled, full_matrices=False)
    used = sizes > tolerance * sizes.max(initial=0.0)
    return u[:, used], vt[used].T / sizes[used] / scale[:, None], vt[~used] / scale


def solve(factor: Factor) -> LeastSquaresSolution:
    """Return the least-squares solution, of minimum norm where it is not unique."""
    basis, axes, unexcited = independent_axes(factor.r[:, :-1])
    values = axes @ (basis.T @ factor.r[:, -1])
    return LeastSquaresSolution(values, axes @ axes.T, tuple(unexcited))


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
    """Return the parameters that dominate a direction, as in ``+0.71 Ixx5 -0.71 Iyy5``."""
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
    """Return the conditioning of the full regressor, which is base columns · combination."""
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
#: Least noise of a joint, of the RMS torque of all: rows of one that is fitted exactly, as of a
#: torque that was not recorded, must not be all that counts.
LEAST_NOISE = 1e-6


@dataclass(frozen=True, eq=False)
class Weighting:
    """Weighted rows of an estimator."""

    factor: Factor  # of all rows, weighted
    noise: Array  # (n,): residual standard deviation per joint, N·m
    rows: tuple[Array, ...]  # weight of each row of each joint
    converged: bool


def ols(rows: Rows, noise: Array) -> Weighting:
    """Ordinary least squares: the same weight for every row, whatever the noise."""
    factor = stacked(rows)
    noise = _noise(rows.factors, solve(factor).values, rows)
    return Weighting(factor, noise, row_weights(rows, np.ones(len(rows.joints))), True)


def wls(rows: Rows, noise: Array) -> Weighting:
    """Weighted least squares: rows divided by their joint's residual noise (n,), iterated."""
    factors, converged = rows.factors, False
    for _ in range(ITERATIONS):
        factor = combine(factors, 1.0 / noise)
        fresh = _noise(factors, solve(factor).values, rows)
        converged = bool(np.all(np.abs(fresh - noise) <= CONVERGED * noise))
        noise = fresh
        if converged:
            break
    return Weighting(
        combine(factors, 1.0 / noise), noise, row_weights(rows, 1.0 / noise), converged
    )


def robust(rows: Rows, noise: Array) -> Weighting:
    """Huber's M-estimator by iteratively reweighted least squares; joint noise from the MAD."""
    start = wls(rows, noise)
    values, converged = solve(start.factor).values, False
    weights, noise, factor = list(start.rows), start.noise, start.factor
    least = _least_noise(rows)
    for _ in range(ITERATIONS):
        residuals = rows.residuals(values)
        spread = [median_abs_deviation(e, scale="normal") if len(e) else 1.0 for e in residuals]
        noise = np.maximum(spread, least)
        # rows are multiplied by the square root of Huber's weight over the joint's noise
        weights = [
            np.sqrt(np.minimum(1.0, HUBER * s / np.maximum(np.abs(e), SMALLEST_NOISE))) / s
            for e, s in zip(residuals, noise, strict=True)
        ]
        factor = stacked(rows, weights)
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
    noise, least, uses = [], _least_noise(rows), np.zeros(rows.count)
    for joint in rows.joints:
        uses[joint.columns] += len(joint.torque)
    for factor, joint in zip(factors, rows.joints, strict=True):
        # parameters are shared between joints: each joint has its part of their number
        mean = float(uses[joint.columns].sum()) / max(len(joint.columns), 1)
        share = len(joint.columns) * factor.rows / max(mean, 1.0)
        freedom = max(factor.rows - share, 1.0)
        size = np.sqrt(factor.misfit(values) / freedom) if factor.rows else 1.0
        noise.append(max(float(size), least))
    return np.array(noise)


def _least_noise(rows: Rows) -> float:
    torque = np.concatenate([joint.torque for joint in rows.joints])
    rms = np.linalg.norm(torque) / np.sqrt(max(len(torque), 1))
    return max(LEAST_NOISE * float(rms), SMALLEST_NOISE)


def row_weights(rows: Rows, per_joint: Array) -> tuple[Array, ...]:
    """Return one weight per row (R,) of each joint, from one per joint (n,)."""
    return tuple(np.full(length, w) for length, w in zip(rows.lengths, per_joint, strict=True))


def size_of_function(rows: Array, own: Indices) -> float:
    """Return the size at which coefficients, if all are equal, have the torque that they explain.

    ``rows`` (R, p + 1) are equations [matrix | torque], of which both are what the other parameters
    do not explain. Larger coefficients cancel each other on these rows, and do not on others.
    """
    others = np.setdiff1d(np.arange(rows.shape[1] - 1), own)
    triangle = np.linalg.qr(rows[:, np.concatenate([others, own, [-1]])]).R
    outside = triangle[len(others) : -1, len(others) :]
    return float(np.linalg.norm(outside[:, -1]) / np.linalg.norm(outside[:, :-1]))
