"""What a model leaves of the torque, beside its own columns: rows that functions are fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from lieid_casadi.diagnosis.screening.context import Scene
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals
from lieid_casadi.diagnosis.screening.screen import Baseline
from lieid_casadi.diagnosis.search.candidate_selection import BLOCK, FOLD, block_index
from lieid_casadi.diagnosis.search.rivals import FOLDS
from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs

Array = NDArray[np.float64]
SEEN = 1e-3  # part of a direction that the model's own columns must leave for it to be fitted
CONFIDENCE = 0.95


@dataclass(frozen=True, eq=False)
class Estimate:
    """Coefficients (k,) of columns beside a model, their covariance (k, k), and t's quantile."""

    values: Array
    covariance: Array
    quantile: float

    @property
    def std(self) -> Array:
        """Standard deviations (k,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


@dataclass(frozen=True, eq=False)
class Remainder:
    """A residual on rows of equal noise, and what a joint's rows of a new column would be.

    Attributes
    ----------
    signals : tuple of SegmentSignals
    runs, noise : tuple
        Of each joint; the noise is white.
    baseline : Baseline
    folds, blocks : (R,) int
        Of each row: fold of the cross-validation, block of time.
    """

    signals: tuple[SegmentSignals, ...]
    runs: tuple[Runs, ...]
    noise: tuple[Noise, ...]
    baseline: Baseline
    folds: NDArray[np.intp]
    blocks: NDArray[np.intp]

    @classmethod
    def of(cls, scene: Scene, noise: Sequence[Noise], baseline: Baseline) -> Remainder:
        """Return what a baseline leaves on a scene's rows, whitened by ``noise``."""
        folds = block_index(scene, noise, FOLD) % FOLDS
        blocks = block_index(scene, noise, BLOCK)
        return cls(scene.signals, scene.runs, tuple(noise), baseline, folds, blocks)

    @property
    def revolute(self) -> tuple[bool, ...]:
        """Which joints turn."""
        robot = self.signals[0].arm.compiled.model.robot
        return tuple(joint.revolute for joint in robot.joints)

    def columns(self, joint: int, values: Sequence[Array]) -> Array:
        """Return columns on all rows (R, k) that act on one joint.

        Parameters
        ----------
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

    def beside_model(self, columns: Array) -> Array:
        """Return the part of columns (R, k) that the model's own do not span."""
        basis = self.baseline.basis
        rest = columns - basis @ (basis.T @ columns)
        return np.asarray(rest - basis @ (basis.T @ rest))

    def fit(self, columns: Array) -> Estimate:
        """Fit columns (R, k) to the residual beside the model (Frisch, Waugh, Lovell).

        The covariance holds for errors that depend on each other within blocks of time (Liang,
        Zeger, Biometrika 1986). Directions that the model imitates stay at zero.
        """
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        rest = self.beside_model(columns) / size
        u, sizes, axes = np.linalg.svd(rest, full_matrices=False)
        seen = sizes > SEEN * np.sqrt(rest.shape[1])
        inverse = (axes[seen].T / sizes[seen]) @ u[:, seen].T
        values = inverse @ self.baseline.residual
        error = self.baseline.residual - rest @ values
        count = int(self.blocks.max(initial=-1)) + 1
        blocks = np.concatenate(  # rows of a prior are blocks of their own
            [self.blocks, count + np.arange(len(error) - len(self.blocks))]
        )
        scores = np.zeros((int(blocks.max()) + 1, len(values)))
        np.add.at(scores, blocks, (inverse * error).T)
        freedom = max(count - 1, 1)
        covariance = scores.T @ scores * ((count) / freedom)
        white = inverse @ inverse.T * float(np.mean(error[: len(self.blocks)] ** 2))
        # few blocks say little of their own: never less than errors without memory give
        larger = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(covariance), 1e-300), 1.0))
        covariance = covariance * np.outer(larger, larger)
        scale = np.outer(size, size)
        quantile = float(student.ppf(0.5 + 0.5 * CONFIDENCE, freedom))
        return Estimate(values / size, covariance / scale, quantile)
