"""The residual outside the span of the model's columns, to which functions are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.cross_validation import cross_validated_gain
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals
from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs

Array = NDArray[np.float64]
LEAST_OWN_PART = 1e-3  # of a direction outside the model's span, for its coefficient to be fitted


@dataclass(frozen=True, eq=False)
class ColumnEstimate:
    """Estimated coefficients of columns fitted in addition to a model.

    Attributes
    ----------
    values : (k,)
    covariance : (k, k)
    quantile : float
        Of Student's t, for two-sided confidence bands.
    """

    values: Array
    covariance: Array
    quantile: float

    @property
    def std(self) -> Array:
        """Standard deviations (k,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


@dataclass(frozen=True, eq=False)
class ProjectedResidual:
    """A residual on whitened rows, and the operations that fit further columns to it.

    Attributes
    ----------
    signals : tuple of SegmentSignals
    runs, noise : tuple
        Of each joint; the noise is white.
    baseline : Baseline
        Of R rows.
    folds, blocks : (R,) int
        Of each row: fold of the cross-validation, and block of time.
    options : DiagnosisOptions
    """

    signals: tuple[SegmentSignals, ...]
    runs: tuple[Runs, ...]
    noise: tuple[Noise, ...]
    baseline: Baseline
    folds: NDArray[np.intp]
    blocks: NDArray[np.intp]
    options: DiagnosisOptions

    @classmethod
    def of(
        cls, context: ScreeningContext, noise: Sequence[Noise], baseline: Baseline
    ) -> ProjectedResidual:
        """Return the residual of a baseline on the rows of a context.

        Parameters
        ----------
        context : ScreeningContext
        noise : sequence of Noise
            Of each joint, white.
        baseline : Baseline
            Whitened by ``noise``.
        """
        options = context.options
        blocks = context.time_blocks(noise, options.block_duration)
        folds = context.folds(noise)
        return cls(context.signals, context.runs, tuple(noise), baseline, folds, blocks, options)

    @property
    def revolute(self) -> tuple[bool, ...]:
        """Whether each joint is revolute."""
        robot = self.signals[0].arm.compiled.model.robot
        return tuple(joint.revolute for joint in robot.joints)

    def columns(self, joint: int, values: Sequence[Array]) -> Array:
        """Return columns (R, k) that act on one joint, filtered and whitened.

        Parameters
        ----------
        joint : int
            From 0.
        values : sequence of (K, k)
            Along each segment, not filtered.
        """
        filtered = np.concatenate(
            [s.segment.filter(v) for s, v in zip(self.signals, values, strict=True)]
        )
        runs = self.runs[joint]
        rows = np.zeros((self.baseline.rows, filtered.shape[1]))
        rows[self.baseline.joint(joint)] = self.noise[joint].whiten(filtered[runs.all], runs)
        return rows

    def carries_over(self, columns: Array) -> bool:
        """Whether columns (R, k) reduce the error on the parts that their fit leaves out."""
        return cross_validated_gain(columns, self.baseline, self.folds) > 0.0

    def fit(self, columns: Array) -> ColumnEstimate:
        """Fit columns (R, k) to the residual in addition to the model (Frisch, Waugh, Lovell).

        The covariance is valid for errors that are correlated within blocks of time (Liang,
        Zeger, Biometrika 1986) and never smaller than for uncorrelated errors. Directions that
        the model spans have the coefficient zero.
        """
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        rest = self.baseline.outside(columns) / size
        u, sizes, axes = np.linalg.svd(rest, full_matrices=False)
        seen = sizes > LEAST_OWN_PART * np.sqrt(rest.shape[1])
        inverse = (axes[seen].T / sizes[seen]) @ u[:, seen].T
        values = inverse @ self.baseline.residual
        error = self.baseline.residual - rest @ values
        covariance, freedom = self._clustered(inverse, error)
        white = inverse @ inverse.T * float(np.mean(error[: len(self.blocks)] ** 2))
        # a few blocks alone would underestimate the variance
        larger = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(covariance), 1e-300), 1.0))
        covariance = covariance * np.outer(larger, larger)
        quantile = float(student.ppf(0.5 + 0.5 * self.options.confidence, freedom))
        return ColumnEstimate(values / size, covariance / np.outer(size, size), quantile)

    def _clustered(self, inverse: Array, error: Array) -> tuple[Array, int]:
        """Return the covariance (k, k) for errors (R,) correlated within blocks, and its freedom.

        Rows of a prior are blocks of their own.
        """
        count = int(self.blocks.max(initial=-1)) + 1
        blocks = np.concatenate([self.blocks, count + np.arange(len(error) - len(self.blocks))])
        scores = np.zeros((int(blocks.max()) + 1, len(inverse)))
        np.add.at(scores, blocks, (inverse * error).T)
        freedom = max(count - 1, 1)
        return np.asarray(scores.T @ scores * (count / freedom)), freedom
