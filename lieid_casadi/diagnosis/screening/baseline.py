"""The model's own columns and the residual of their fit, with which candidates are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from lieid_casadi.diagnosis.options import ABSORBED, RANK_TOLERANCE
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Baseline:
    """The span of a model's columns on the whitened rows of all joints, and the residual.

    Rows of a prior may follow the rows of the joints.

    Attributes
    ----------
    model : (R, p)
        Orthonormal basis of the model's columns.
    added : (R, a)
        Orthonormal basis of the columns added to it, orthogonal to ``model``.
    residual : (R,)
        Whitened torque minus its projection onto both.
    ends : (n + 1,) int
        Joint j has rows ends[j] to ends[j + 1].
    """

    model: Array
    added: Array
    residual: Array
    ends: NDArray[np.intp]

    @classmethod
    def of(cls, matrices: Sequence[Array], torques: Sequence[Array]) -> Baseline:
        """Return the baseline of whitened columns and torques.

        Parameters
        ----------
        matrices : sequence of (R_j, p)
            Columns of the model on the rows of each joint; rows of a prior may come last.
        torques : sequence of (R_j,)
        """
        matrix = np.concatenate(matrices)
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale == 0.0] = 1.0
        basis, triangle, _ = qr(matrix / scale, mode="economic", pivoting=True)
        sizes = np.abs(np.diag(triangle))
        basis = basis[:, sizes > RANK_TOLERANCE * sizes.max(initial=1e-300)]
        torque = np.concatenate(torques)
        ends = np.concatenate([[0], np.cumsum([len(t) for t in torques])]).astype(np.intp)
        residual = torque - basis @ (basis.T @ torque)
        return cls(basis, np.zeros((len(torque), 0)), residual, ends)

    @property
    def rows(self) -> int:
        """Number of rows R."""
        return len(self.residual)

    def joint(self, j: int) -> slice:
        """Return the rows of joint j."""
        return slice(int(self.ends[j]), int(self.ends[j + 1]))

    def padded(self, columns: Array) -> Array:
        """Return columns (…, k) on the rows of the joints as (R, k): zero on rows of a prior."""
        return np.pad(columns, ((0, self.rows - len(columns)), (0, 0)))

    @property
    def rank(self) -> int:
        """Dimension of the span."""
        return int(self.model.shape[1] + self.added.shape[1])

    def project_out(self, columns: Array) -> Array:
        """Return columns (R, k) minus their projection onto the span."""
        rest = columns - self.model @ (self.model.T @ columns)
        if self.added.shape[1]:
            rest = rest - self.added @ (self.added.T @ columns)
        return np.asarray(rest)

    def outside(self, columns: Array) -> Array:
        """Return the part of columns (R, k) outside the span, projected twice against rounding."""
        return self.project_out(self.project_out(columns))

    def with_columns(self, columns: Array) -> Baseline:
        """Return the baseline of a model with further columns (…, k)."""
        columns = self.padded(columns)
        norms = np.linalg.norm(columns, axis=0)
        rest = self.outside(columns) / np.where(norms > 0, norms, 1.0)
        u, sizes, _ = np.linalg.svd(rest, full_matrices=False)
        new = u[:, sizes > ABSORBED]
        residual = self.residual - new @ (new.T @ self.residual)
        return Baseline(self.model, np.hstack([self.added, new]), residual, self.ends)

    def coefficients(self, columns: Array, *, least: float) -> Array:
        """Return the coefficients (k,) of further columns (…, k) fitted in addition to the model.

        Directions with less than ``least`` of a unit column outside the span stay at zero.
        """
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        rest = self.project_out(self.padded(columns))
        return np.asarray(np.linalg.lstsq(rest / size, self.residual, rcond=least)[0] / size)


def with_groups(
    baseline: Baseline, candidates: CandidateColumns[Any], groups: Sequence[int]
) -> Baseline:
    """Return the baseline of a model to which groups of candidate columns are added.

    Parameters
    ----------
    baseline : Baseline
    candidates : CandidateColumns
        Whitened as the baseline is.
    groups : sequence of int
    """
    for group in groups:
        baseline = baseline.with_columns(candidates.stacked(group))
    return baseline
