"""The final model of a diagnosis without single effects, from inner products of its columns.

Effects are left out and the remaining linear parameters fitted again, with the weights of the final
fit; shape parameters keep their values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.diagnosis.evidence import solved
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import training_rms
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
    """The final model on its training recordings."""

    fit: Fit
    segments: Sequence[Processed]
    #: (p + 1, p + 1) of each joint: inner products of columns and torque of its rows in motion
    train: tuple[Array, ...]
    #: (p + 1, p + 1): inner products of what is known before any data
    priors: Array
    #: (n,): numbers of these rows
    counts: Array
    #: those of the fit's cross-validated error
    folds: tuple[Fold, ...]

    @classmethod
    def of(cls, fit: Fit, segments: Sequence[Processed]) -> FinalModel:
        """Return the final model of a fit to segments."""
        design = Design(fit.compiled, segments)
        rows = design.rows(fit.shapes, fit.parameters)
        train, counts = _products(rows)
        known = with_priors(Factor(np.zeros((1, rows.count + 1)), 0), design).r
        folds = fold_factors(design, rows, fit.noise, fit.values)
        return cls(fit, segments, train, known.T @ known, counts, folds)

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

    def without(self, columns: Indices) -> Fit:
        """Return the fit without some columns and its errors; the covariance is the final one."""
        fit, values = self.fit, self._values(columns)
        parameters = np.zeros_like(fit.parameters)
        parameters[fit.model.base.kept] = values
        rms, raw = training_rms(fit.compiled, self.segments, parameters, fit.shapes)
        return replace(
            fit, values=values, parameters=parameters, rms_train=rms, rms_train_raw=raw,
            rms_cv=self.cross_validated(columns),
        )  # fmt: skip

    def rms_moving(self, without: Indices) -> Array:
        """Return the training error in motion (n,) without some columns, N·m."""
        full = np.append(-self._values(without), 1.0)
        squares = np.maximum(np.einsum("a,jab,b->j", full, np.array(self.train), full), 0.0)
        unknown = np.full(len(squares), np.nan)
        mean = np.divide(squares, self.counts, out=unknown, where=self.counts > 0)
        return np.asarray(np.sqrt(mean))

    def _values(self, without: Indices) -> Array:
        """Return the values (p,), fitted again, zero for some columns."""
        values = np.zeros(len(self.fit.values))
        kept = np.setdiff1d(np.arange(len(values)), without)
        weights = 1.0 / self.fit.noise**2
        gram = np.einsum("j,jab->ab", weights, np.array(self.train)) + self.priors
        values[kept] = solved(gram[np.ix_(kept, kept)], gram[kept, -1])
        return values

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
