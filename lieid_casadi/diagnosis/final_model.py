"""The final model of a diagnosis without single effects, from triangular factors of its rows.

Effects are left out and the remaining linear parameters fitted again, with the weights of the final
fit; shape parameters keep their values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import training_rms
from lieid_casadi.identification.regression.cross_validation import (
    Fold,
    cross_validated_rms,
    fold_factors,
)
from lieid_casadi.identification.regression.design_matrix import Design, with_priors
from lieid_casadi.identification.regression.least_squares import Factor, combine
from lieid_casadi.recording import Processed


@dataclass(frozen=True, eq=False)
class FinalModel:
    """The final model on its training recordings."""

    fit: Fit
    segments: Sequence[Processed]
    #: of the rows of each joint in motion, and of all, weighted, with what is known before any data
    joints: Sequence[Factor]
    whole: Factor
    #: those of the fit's cross-validated error
    folds: tuple[Fold, ...]

    @classmethod
    def of(cls, fit: Fit, segments: Sequence[Processed]) -> FinalModel:
        """Return the final model of a fit to segments."""
        design = Design(fit.compiled, segments)
        rows = design.rows(fit.shapes, fit.parameters)
        whole = with_priors(combine(rows.factors, 1.0 / fit.noise), design)
        folds = fold_factors(design, rows, fit.noise, fit.values)
        return cls(fit, segments, rows.factors, whole, folds)

    def columns_of(self, placements: Sequence[Placement]) -> Indices:
        """Return the columns of placed effects."""
        fitted = self.fit.model.base_columns
        found = [k for k, p in enumerate(fitted) if any(map(p.belongs_to, placements))]
        return np.array(found, dtype=np.intp)

    def part_of_torque(self, effect: Placement, joint: int) -> float:
        """Return the RMS torque of an effect on a joint in motion, relative to the measured one."""
        own, r = self.columns_of([effect]), self.joints[joint].r
        parts = r[:, own] @ self.fit.values[own], r[:, -1]
        torque, measured = (float(np.linalg.norm(part)) for part in parts)
        return torque / max(measured, 1e-150)

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
        fit, values = self.fit, self._estimate(self.whole, columns)
        parameters = np.zeros_like(fit.parameters)
        parameters[fit.model.base.kept] = values
        rms, raw = training_rms(fit.compiled, self.segments, parameters, fit.shapes)
        return replace(
            fit, values=values, parameters=parameters, rms_train=rms, rms_train_raw=raw,
            rms_cv=self.cross_validated(columns),
        )  # fmt: skip

    def rms_moving(self, without: Indices) -> Array:
        """Return the training error in motion (n,) without some columns, N·m."""
        values = self._estimate(self.whole, without)
        return np.sqrt([factor.misfit(values) / max(factor.rows, 1) for factor in self.joints])

    def cross_validated(self, without: Indices) -> Array:
        """Return the errors in motion (n,) of held-out blocks without some columns, N·m."""
        return cross_validated_rms(self.folds, lambda factor: self._estimate(factor, without))

    def _estimate(self, factor: Factor, without: Indices) -> Array:
        """Return the values (p,) by the rows of a factor, zero for some columns."""
        found, r = np.zeros(len(self.fit.values)), factor.r
        kept = np.setdiff1d(np.arange(len(found)), without)
        found[kept] = np.linalg.lstsq(r[:, kept], r[:, -1], rcond=1e-10)[0]
        return found
