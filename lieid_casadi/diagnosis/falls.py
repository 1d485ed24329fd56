"""Errors of the final model without each step, and of the models on the way to it.

Steps are left out of the final model and the remaining linear parameters fitted again; shape
parameters keep their final values. All errors follow from inner products of the final model's
columns, so that leaving a step out costs nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.diagnosis.nested import solved
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.cross_validation import (
    BLOCK_OVER_CUTOFF,
    Fold,
    cross_validated_rms,
    fold_factors,
)
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import Factor, Rows
from lieid_casadi.recording import Processed

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class FinalModel:
    """The final model on its training recordings and on a test.

    Attributes
    ----------
    fit : Fit
    train, test : tuple of (p + 1, p + 1)
        Of each joint: inner products of columns and torque of its rows in motion. ``test`` is
        None without one.
    counts, test_counts : (n,)
        Numbers of these rows.
    folds : tuple of Fold
        Those of the fit's cross-validated error.
    """

    fit: Fit
    train: tuple[Array, ...]
    counts: Array
    test: tuple[Array, ...] | None
    test_counts: Array
    folds: tuple[Fold, ...]

    @classmethod
    def of(
        cls, fit: Fit, segments: Sequence[Processed], tests: Sequence[Processed] | None
    ) -> FinalModel:
        """Return the final model of a fit to segments, and to those of a test."""
        rows = Design(fit.compiled, segments).rows(fit.shapes, fit.parameters)
        train, counts = _products(rows)
        of_test, test_counts = None, np.zeros(fit.model.n)
        if tests:
            of_test, test_counts = _products(
                Design(fit.compiled, tests).rows(fit.shapes, fit.parameters)
            )
        time = segments[0].filtered_time
        step = float(time[1] - time[0]) if len(time) > 1 else 1.0
        block = max(int(BLOCK_OVER_CUTOFF / segments[0].cutoff / step), 1)
        folds = fold_factors(rows, fit.noise, fit.values, block=block)
        return cls(fit, train, counts, of_test, test_counts, folds)

    def columns_of(self, placements: Sequence[Placement]) -> Indices:
        """Return the columns of placed effects."""
        found = []
        for k, parameter in enumerate(self.fit.model.base_columns):
            name = parameter.name.rpartition(".")[0]
            if any(name == p.effect.label and parameter.joint == p.joint for p in placements):
                found.append(k)
        return np.array(found, dtype=np.intp)

    def errors(self, without: Indices) -> dict[str, Array | None]:
        """Return the errors in motion (n,) without some columns, N·m: train, cv and test."""
        count = len(self.fit.values)
        kept = np.setdiff1d(np.arange(count), without)
        values = np.zeros(count)
        weights = 1.0 / self.fit.noise**2
        gram = np.einsum("j,jab->ab", weights, np.array(self.train))
        values[kept] = solved(gram[np.ix_(kept, kept)], gram[kept, -1])

        def estimate(factor: Factor) -> Array:
            found = np.zeros(count)
            r = factor.r
            found[kept] = np.linalg.lstsq(r[:, kept], r[:, -1], rcond=1e-10)[0]
            return found

        return {
            "train": _rms(self.train, self.counts, values),
            "cv": cross_validated_rms(self.folds, estimate),
            "test": None if self.test is None else _rms(self.test, self.test_counts, values),
        }


def _products(rows: Rows) -> tuple[tuple[Array, ...], Array]:
    """Return inner products (p + 1, p + 1) and number of rows of each joint."""
    found, counts = [], []
    for joint in rows.joints:
        wide = np.zeros((rows.count + 1, rows.count + 1))
        own = np.append(joint.columns, rows.count)
        values = np.column_stack([joint.matrix, joint.torque])
        wide[np.ix_(own, own)] = values.T @ values
        found.append(wide)
        counts.append(len(joint.torque))
    return tuple(found), np.array(counts, dtype=float)


def _rms(products: Sequence[Array], counts: Array, values: Array) -> Array:
    """Return the RMS (n,) of torque minus columns · values."""
    full = np.append(-values, 1.0)
    squares = np.array([max(float(full @ gram @ full), 0.0) for gram in products])
    mean = np.divide(squares, counts, out=np.full(len(counts), np.nan), where=counts > 0)
    return np.asarray(np.sqrt(mean))
