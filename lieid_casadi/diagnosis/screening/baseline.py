"""The model's own columns and the residual of their fit, with which candidates are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import ABSORBED
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns

Array = NDArray[np.float64]
#: Part of a column left by a projection, below which rounding errors make a second one necessary
#: (Rutishauser; Daniel et al., Math. Comp. 1976).
CANCELLED = 0.1


@dataclass(frozen=True, eq=False)
class Baseline:
    """The span of a model's columns on the whitened rows of all joints, and the residual.

    Rows of a prior may follow the rows of the joints.

    Attributes
    ----------
    model : (R, p)
        Orthonormal basis of the columns of the model, or of a larger one.
    left_out : (p, s)
        Orthonormal directions of that basis that the model does not span.
    added : (R, a)
        Orthonormal basis of the columns added to the model, orthogonal to its span.
    residual : (R,)
        Whitened torque minus its projection onto both.
    ends : (n + 1,) int
        Joint j has rows ends[j] to ends[j + 1].
    """

    model: Array
    left_out: Array
    added: Array
    residual: Array
    ends: NDArray[np.intp]

    @cached_property
    def axes(self) -> Array:
        """Orthonormal directions (p, p − s) of ``model`` that the model spans."""
        every, _ = np.linalg.qr(self.left_out, mode="complete")
        return np.asarray(every[:, self.left_out.shape[1] :])

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
        return int(self.model.shape[1] - self.left_out.shape[1] + self.added.shape[1])

    def project_out(self, columns: Array) -> Array:
        """Return columns (R, k) minus their projection onto the span."""
        along = np.zeros((self.model.shape[1], columns.shape[1]))
        for j in range(len(self.ends) - 1):
            rows = self.joint(j)
            if columns[rows].any():  # most columns act on one joint
                along += self.model[rows].T @ columns[rows]
        rest = columns - self.model @ (along - self.left_out @ (self.left_out.T @ along))
        if self.added.shape[1]:
            rest = rest - self.added @ (self.added.T @ columns)
        return np.asarray(rest)

    def outside(self, columns: Array) -> Array:
        """Return the part of columns (R, k) outside the span, free of its rounding errors."""
        rest = self.project_out(columns)
        before, after = (np.linalg.norm(x, axis=0) for x in (columns, rest))
        again = after < CANCELLED * before
        if again.any():
            rest[:, again] = self.project_out(rest[:, again])
        return rest

    def with_columns(self, columns: Array) -> Baseline:
        """Return the baseline of a model with further columns (…, k)."""
        return self.with_part(self.part(columns))

    def part(self, columns: Array) -> Array:
        """Return the part of further columns (…, k), at unit length, outside the span (R, k)."""
        columns = self.padded(columns)
        norms = np.linalg.norm(columns, axis=0)
        return self.outside(columns) / np.where(norms > 0, norms, 1.0)

    def with_part(self, part: Array) -> Baseline:
        """Return the baseline with further columns, given their part (R, k) outside the model.

        It is `part` of this baseline or of one to which fewer columns were added.
        """
        if self.added.shape[1]:
            for _ in range(2):  # against rounding
                part = part - self.added @ (self.added.T @ part)
        u, sizes, _ = np.linalg.svd(part, full_matrices=False)
        new = u[:, sizes > ABSORBED]
        residual = self.residual - new @ (new.T @ self.residual)
        return replace(self, added=np.hstack([self.added, new]), residual=residual)

    def fall(self, larger: Baseline) -> float:
        """Return the fall of the sum of squares to a baseline with further columns."""
        return float(np.sum(self.residual**2) - np.sum(larger.residual**2))

    def evidence(self, columns: Array, n: int) -> tuple[float, int, float]:
        """Return the evidence for further columns (…, k) on n joints.

        Returns
        -------
        statistic : float
            Fall of the sum of squares, divided by the dispersion.
        degrees : int
            Degrees of freedom of its chi-square distribution without an effect.
        dispersion : float
        """
        larger, dispersion = self.with_columns(columns), self.dispersion(columns, n)
        return self.fall(larger) / dispersion, max(larger.rank - self.rank, 1), dispersion

    def dispersion(self, columns: Array, n: int) -> float:
        """Return the mean square of the residual after columns (…, k) are fitted, at least 1.

        Each of the n joints counts by its part of the torque that the columns explain, so that a
        noisy joint does not change the evidence for an effect on another one.
        """
        rest = self.outside(self.padded(columns))
        explained = rest @ np.linalg.lstsq(rest, self.residual, rcond=ABSORBED)[0]
        after = self.residual - explained
        freedom = max(1.0 - (self.rank + rest.shape[1]) / self.rows, 1.0 / self.rows)
        joints = [self.joint(j) for j in range(n)]
        weights = np.array([np.sum(explained[rows] ** 2) for rows in joints])
        sizes = np.array([np.sum(after[rows] ** 2) / max(len(after[rows]), 1) for rows in joints])
        total = float(weights.sum())
        return float(weights @ np.maximum(sizes / freedom, 1.0)) / total if total > 0.0 else 1.0

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
