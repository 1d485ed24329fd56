"""The final model of a diagnosis: its errors without single effects, from inner products.

Effects are left out and the remaining linear parameters fitted again; shape parameters keep their
final values. All errors follow from inner products of the final model's columns, so that leaving an
effect out costs nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.diagnosis.evidence import solved
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.cross_validation import (
    Fold,
    cross_validated_rms,
    fold_factors,
)
from lieid_casadi.identification.regression.design_matrix import Design, with_priors
from lieid_casadi.identification.regression.least_squares import Factor, Rows
from lieid_casadi.recording import Processed


@dataclass(frozen=True, eq=False)
class FinalModel:
    """The final model on its training recordings and on a test."""

    fit: Fit
    #: (p + 1, p + 1) of each joint: inner products of columns and torque of its rows in motion
    train: tuple[Array, ...]
    #: (p + 1, p + 1): inner products of what is known before any data
    priors: Array
    #: (n,): numbers of these rows
    counts: Array
    test: tuple[Array, ...] | None
    test_counts: Array
    #: those of the fit's cross-validated error
    folds: tuple[Fold, ...]

    @classmethod
    def of(
        cls, fit: Fit, segments: Sequence[Processed], tests: Sequence[Processed] | None
    ) -> FinalModel:
        """Return the final model of a fit to segments, and to those of a test."""
        design = Design(fit.compiled, segments)
        rows = design.rows(fit.shapes, fit.parameters)
        train, counts = _products(rows)
        known = with_priors(Factor(np.zeros((1, rows.count + 1)), 0), design).r
        of_test, test_counts = None, np.zeros(fit.model.n)
        if tests:
            of_test, test_counts = _products(
                Design(fit.compiled, tests).rows(fit.shapes, fit.parameters)
            )
        folds = fold_factors(design, rows, fit.noise, fit.values)
        return cls(fit, train, known.T @ known, counts, of_test, test_counts, folds)

    def columns_of(self, placements: Sequence[Placement]) -> Indices:
        """Return the columns of placed effects."""
        fitted = self.fit.model.base_columns
        found = [k for k, p in enumerate(fitted) if any(map(p.belongs_to, placements))]
        return np.array(found, dtype=np.intp)

    def part_of_torque(self, effect: Placement, joint: int) -> float:
        """Return the RMS torque of an effect on a joint in motion, relative to the measured one."""
        own, gram = self.columns_of([effect]), self.train[joint]
        values = self.fit.values[own]
        return float(np.sqrt(values @ gram[np.ix_(own, own)] @ values / max(gram[-1, -1], 1e-300)))

    def fall(self, effect: Placement, joint: int, gone: Sequence[Placement]) -> float:
        """Return by what part an effect lowers the cross-validated error of a joint.

        That is of the model without the effects ``gone``.
        """
        after, before = (
            self.cross_validated(self.columns_of(without))[joint]
            for without in (gone, [*gone, effect])
        )
        return float(1.0 - after / before)

    def errors(self, without: Indices) -> dict[str, Array | None]:
        """Return the errors in motion (n,) without some columns, N·m, as `Step.errors`."""
        count = len(self.fit.values)
        kept = np.setdiff1d(np.arange(count), without)
        values = np.zeros(count)
        weights = 1.0 / self.fit.noise**2
        gram = np.einsum("j,jab->ab", weights, np.array(self.train)) + self.priors
        values[kept] = solved(gram[np.ix_(kept, kept)], gram[kept, -1])
        lasting = values * (self.fit.lasting_values == self.fit.values)
        test = None if self.test is None else _rms(self.test, self.test_counts, lasting)
        return {
            "rms_train": _rms(self.train, self.counts, values),
            "rms_test": test,
            "rms_test_moving": test,
            "rms_cv": self.cross_validated(without),
        }

    def cross_validated(self, without: Indices) -> Array:
        """Return the errors in motion (n,) of held-out blocks without some columns, N·m."""
        kept = np.setdiff1d(np.arange(len(self.fit.values)), without)

        def estimate(factor: Factor) -> Array:
            found, r = np.zeros(len(self.fit.values)), factor.r
            found[kept] = np.linalg.lstsq(r[:, kept], r[:, -1], rcond=1e-10)[0]
            return found

        return cross_validated_rms(self.folds, estimate)


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
