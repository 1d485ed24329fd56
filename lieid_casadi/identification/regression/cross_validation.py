"""Blocked cross-validation: held-out error without a test recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.compiled.triangular_factors import Triangle
from lieid_casadi.identification.regression.least_squares import (
    RANK_TOLERANCE,
    Factor,
    combine,
    widened,
)
from lieid_casadi.identification.regression.rows import Rows

Estimate = Callable[[Factor], Array]
FOLDS = 3
BLOCK_OVER_CUTOFF = 12.0  # block length, periods of the cut-off: many times the filter's response
#: Part of the information on a direction of the parameters that the rows that are not held out
#: must have. With less, its standard deviation without them is more than ten times that of the
#: fit, and the held-out error shows this extrapolation, not the fit.
LEAST_INFORMATION = 0.01


@dataclass(frozen=True, eq=False)
class Fold:
    """One held-out part of the rows.

    Attributes
    ----------
    rest : Factor
        Of all other rows, weighted, and of what `with_whole_fit` adds.
    held : tuple of Factor
        Of the held-out rows, one per joint, not weighted.
    """

    rest: Factor
    held: tuple[Factor, ...]

    def squares(self, values: Array) -> Array:
        """Return the sum of squared held-out residuals per joint (n,)."""
        return np.array([factor.misfit(values) for factor in self.held])


def fold_factors(rows: Rows, noise: Array, values: Array, *, block: int) -> tuple[Fold, ...]:
    """Return the folds; blocks of consecutive instants are assigned to them in turn.

    Parameters
    ----------
    noise : (n,)
        Standard deviation of the residual per joint, N·m; rows are weighted by its inverse.
    values : (p,)
        Of the fit of all rows.
    block : int
        Instants per block.
    """
    triangles = [[Triangle(len(own) + 1) for own in rows.columns] for _ in range(FOLDS)]
    counts = np.zeros((FOLDS, len(rows.columns)), dtype=np.intp)
    for part, _ in rows.chunks():
        fold = _folds(part, block)
        for j, joint in enumerate(part.joints):
            for held in range(FOLDS):
                use = fold[joint.instant] == held
                triangles[held][j].add(joint.matrix[use], joint.torque[use])
                counts[held, j] += int(use.sum())
    parts = [
        tuple(
            widened(triangle.r, own, rows.count, int(count))
            for triangle, own, count in zip(of_fold, rows.columns, number, strict=True)
        )
        for of_fold, number in zip(triangles, counts, strict=True)
    ]
    folds = []
    for held, own in enumerate(parts):
        others = [factor for k, part in enumerate(parts) if k != held for factor in part]
        rest = combine(others, np.tile(1.0 / noise, FOLDS - 1))
        folds.append(Fold(with_whole_fit(rest, combine(own, 1.0 / noise), values), own))
    return tuple(folds)


def with_whole_fit(rest: Factor, held: Factor, values: Array) -> Factor:
    """Return a factor whose solution keeps values of the whole fit where it has little information.

    These are the directions on which ``rest`` has less than `LEAST_INFORMATION` of the
    information of all rows. What a fit cannot determine is in its covariance.

    Parameters
    ----------
    rest, held : Factor
        Weighted, of the other rows and of the held-out rows.
    values : (p,)
        Of the fit of all rows.
    """
    whole = combine([rest, held], [1.0, 1.0]).r[:, :-1]
    scale = np.linalg.norm(whole, axis=0)
    scale[scale == 0.0] = 1.0
    u, sizes, vt = np.linalg.svd(whole / scale, full_matrices=False)
    excited = sizes > RANK_TOLERANCE * sizes.max(initial=0.0)
    along = rest.r[:, :-1] @ ((vt[excited].T / sizes[excited]) / scale[:, None])
    parts, directions = np.linalg.eigh(along.T @ along)
    few = parts < LEAST_INFORMATION
    if not few.any():
        return rest
    missing = np.sqrt(np.clip(1.0 - parts[few], 0.0, None))
    added = missing[:, None] * (directions[:, few].T @ (u[:, excited].T @ whole))
    return combine([rest, Factor(np.column_stack([added, added @ values]), 0)], [1.0, 1.0])


def cross_validated_rms(folds: Sequence[Fold], estimate: Estimate) -> Array:
    """Return the RMS (n,) of each joint's held-out rows, N·m; NaN for a joint without rows.

    Each fold is predicted with the linear parameters of the others, along directions on which
    these have little information with those of the whole fit. Weights, load and shape parameters
    are those of the whole fit.

    Parameters
    ----------
    estimate : callable
        Weighted factor to base values (p,).
    """
    squares = sum(fold.squares(estimate(fold.rest)) for fold in folds)
    counts = sum(np.array([factor.rows for factor in fold.held], dtype=float) for fold in folds)
    mean = np.divide(squares, counts, out=np.full_like(squares, np.nan), where=counts > 0)
    return np.asarray(np.sqrt(mean))


def _folds(rows: Rows, block: int) -> NDArray[np.intp]:
    """Return the fold of each instant; every segment begins with a new block."""
    fold = np.empty(int(rows.segments[-1]), dtype=np.intp)
    first = 0
    for start, end in zip(rows.segments[:-1], rows.segments[1:], strict=True):
        blocks = first + np.arange(end - start) // block
        fold[start:end] = blocks % FOLDS
        first = int(blocks[-1]) + 1 if len(blocks) else first
    return fold
