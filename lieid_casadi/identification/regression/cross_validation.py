"""Blocked cross-validation: held-out error without a test recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import (
    Factor,
    Rows,
    combine,
    independent_axes,
)
from lieid_casadi.identification.regression.priors import with_priors

Estimate = Callable[[Factor], Array]
FOLDS = 3
BLOCK_OVER_CUTOFF = 12.0  # block length, periods of the cut-off: many times the filter's response
#: Part of the information on a direction of the parameters that the rows that are not held out
#: must have. With less, its standard deviation without them is more than ten times that of the
#: fit, and the held-out error shows this extrapolation, not the fit.
LEAST_INFORMATION = 0.01


@dataclass(frozen=True, eq=False)
class Fold:
    """One held-out part of the rows."""

    rest: Factor  # of all other rows, weighted, and of what `with_whole_fit` adds
    held: tuple[Factor, ...]  # of the held-out rows, one per joint, not weighted

    def squares(self, values: Array) -> Array:
        """Return the sum of squared held-out residuals per joint (n,)."""
        return np.array([factor.misfit(values) for factor in self.held])


def fold_factors(design: Design, rows: Rows, noise: Array, values: Array) -> tuple[Fold, ...]:
    """Return the folds of a design's rows; blocks of consecutive instants go to them in turn.

    What is known before any data belongs to each of them.
    """
    first = design.segments[0]
    time = first.filtered_time
    step = float(time[1] - time[0]) if len(time) > 1 else 1.0
    block = int(BLOCK_OVER_CUTOFF / first.cutoff / step)
    block = max(min(block, int(rows.segments[-1]) // FOLDS), 1)  # every fold has one
    fold = rows.blocks(block) % FOLDS
    parts = [rows.factors_at(fold == held) for held in range(FOLDS)]
    folds = []
    for held, own in enumerate(parts):
        others = [factor for k, part in enumerate(parts) if k != held for factor in part]
        rest = with_priors(combine(others, np.tile(1.0 / noise, FOLDS - 1)), design)
        folds.append(Fold(with_whole_fit(rest, combine(own, 1.0 / noise), values), tuple(own)))
    return tuple(folds)


def with_whole_fit(rest: Factor, held: Factor, values: Array) -> Factor:
    """Return a factor whose solution keeps values of the whole fit where it has little information.

    These are the directions on which ``rest`` has less than `LEAST_INFORMATION` of the
    information of all rows. What a fit cannot determine is in its covariance.
    """
    whole = combine([rest, held], [1.0, 1.0]).r[:, :-1]
    basis, axes, _ = independent_axes(whole)
    along = rest.r[:, :-1] @ axes
    parts, directions = np.linalg.eigh(along.T @ along)
    few = parts < LEAST_INFORMATION
    if not few.any():
        return rest
    missing = np.sqrt(np.clip(1.0 - parts[few], 0.0, None))
    added = missing[:, None] * (directions[:, few].T @ (basis.T @ whole))
    return combine([rest, Factor(np.column_stack([added, added @ values]), 0)], [1.0, 1.0])


def cross_validated_rms(folds: Sequence[Fold], estimate: Estimate) -> Array:
    """Return the RMS (n,) of each joint's held-out rows, N·m; NaN for a joint without rows.

    Each fold is predicted with the linear parameters of the others, along directions on which
    these have little information with those of the whole fit. Weights, shape parameters and the
    load are those of the whole fit; functions of the load follow its changes (`Design.linearized`).
    """
    squares = sum(fold.squares(estimate(fold.rest)) for fold in folds)
    counts = sum(np.array([factor.rows for factor in fold.held], dtype=float) for fold in folds)
    mean = np.divide(squares, counts, out=np.full_like(squares, np.nan), where=counts > 0)
    return np.asarray(np.sqrt(mean))
