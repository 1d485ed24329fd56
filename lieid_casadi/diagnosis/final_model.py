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
from lieid_casadi.identification.regression.design_matrix import Design, follows_load
from lieid_casadi.identification.regression.least_squares import Factor, Rows, combine
from lieid_casadi.identification.regression.priors import with_priors
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
    #: at the load of the fit: without a function of the load nothing changes with it
    at_load: FinalModel | None = None

    @classmethod
    def of(cls, fit: Fit, segments: Sequence[Processed]) -> FinalModel:
        """Return the final model of a fit to segments."""
        design, at = Design(fit.compiled, segments), (fit.shapes, fit.parameters)
        found = cls(fit, segments, *_factors(design, design.rows(*at), fit))
        if not any(follows_load(p.effect) for p in fit.model.placements):
            return found
        return cls(fit, segments, *_factors(design, design.linearized(*at), fit), found)

    def _beside(self, without: Indices) -> FinalModel:
        """Return the equations that hold without some columns."""
        functions = [p for p in self.fit.model.placements if follows_load(p.effect)]
        gone = np.isin(without, self.columns_of(functions)).any()
        return self.at_load if gone and self.at_load is not None else self

    def columns_of(self, placements: Sequence[Placement]) -> Indices:
        """Return the columns of placed effects."""
        fitted = self.fit.model.base_columns
        found = [k for k, p in enumerate(fitted) if any(map(p.belongs_to, placements))]
        return np.array(found, dtype=np.intp)

    def part_of_torque(self, effect: Placement, joint: int) -> float:
        """Return the RMS torque of an effect on a joint in motion, relative to the measured one."""
        own, r = self.columns_of([effect]), (self.at_load or self).joints[joint].r
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
        fit, values = self.fit, self._estimate(self._beside(columns).whole, columns)
        parameters = np.zeros_like(fit.parameters)
        parameters[fit.model.base.kept] = values
        rms, raw = training_rms(fit.compiled, self.segments, parameters, fit.shapes)
        return replace(
            fit, values=values, parameters=parameters, rms_train=rms, rms_train_raw=raw,
            rms_cv=self.cross_validated(columns),
        )  # fmt: skip

    def rms_moving(self, without: Indices) -> Array:
        """Return the training error in motion (n,) without some columns, N·m."""
        own = self._beside(without)
        values = self._estimate(own.whole, without)
        return np.sqrt([factor.misfit(values) / max(factor.rows, 1) for factor in own.joints])

    def cross_validated(self, without: Indices) -> Array:
        """Return the errors in motion (n,) of held-out blocks without some columns, N·m."""
        folds = self._beside(without).folds
        return cross_validated_rms(folds, lambda factor: self._estimate(factor, without))

    def _estimate(self, factor: Factor, without: Indices) -> Array:
        """Return the values (p,) by the rows of a factor, zero for some columns."""
        found, r = np.zeros(len(self.fit.values)), factor.r
        kept = np.setdiff1d(np.arange(len(found)), without)
        found[kept] = np.linalg.lstsq(r[:, kept], r[:, -1], rcond=1e-10)[0]
        return found


def _factors(design: Design, rows: Rows, fit: Fit) -> tuple[list[Factor], Factor, tuple[Fold, ...]]:
    """Return the factors of rows: of each joint, of all, and of the folds."""
    whole = with_priors(combine(rows.factors, 1.0 / fit.noise), design)
    return rows.factors, whole, fold_factors(design, rows, fit.noise, fit.values)
