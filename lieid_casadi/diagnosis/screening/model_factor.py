"""One factorisation of a model's columns, for the baselines of the model and of parts of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import RANK_TOLERANCE
from lieid_casadi.diagnosis.screening.baseline import Baseline

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ModelFactor:
    """QR factorisation of a model's whitened columns on the rows of all joints.

    A model with fewer columns spans a part of the same basis, so that its baseline needs no
    factorisation of its own.

    Attributes
    ----------
    basis : (R, p)
        Orthonormal.
    triangle : (p, p)
        Basis · triangle are the columns at unit length.
    torque : (R,)
        Whitened.
    ends : (n + 1,) int
        Joint j has rows ends[j] to ends[j + 1].
    """

    basis: Array
    triangle: Array
    torque: Array
    ends: NDArray[np.intp]

    @classmethod
    def of(cls, matrices: Sequence[Array], torques: Sequence[Array]) -> ModelFactor:
        """Factorise whitened columns.

        Parameters
        ----------
        matrices : sequence of (R_j, p)
            Columns of the model on the rows of each joint; rows of a prior may come last.
        torques : sequence of (R_j,)
        """
        matrix = np.concatenate(matrices)
        size = np.linalg.norm(matrix, axis=0)
        size[size == 0.0] = 1.0
        basis, triangle = np.linalg.qr(matrix / size)
        ends = np.concatenate([[0], np.cumsum([len(t) for t in torques])]).astype(np.intp)
        return cls(basis, triangle, np.concatenate(torques), ends)

    def baseline(self, without: Sequence[int] = ()) -> Baseline:
        """Return the baseline of the model without some of its columns; each is kept.

        Parameters
        ----------
        without : sequence of int, optional
            Columns that are left out.
        """
        key = tuple(without)
        if key not in self._baselines:
            self._baselines[key] = self._baseline(key)
        return self._baselines[key]

    @cached_property
    def _baselines(self) -> dict[tuple[int, ...], Baseline]:
        return {}

    def _baseline(self, without: tuple[int, ...]) -> Baseline:
        kept = np.delete(self.triangle, np.asarray(without, dtype=np.intp), axis=1)
        axes, sizes, _ = np.linalg.svd(kept)
        rank = int(np.sum(sizes > RANK_TOLERANCE * sizes.max(initial=0.0)))
        left_out = axes[:, rank:]
        along = self.basis.T @ self.torque
        residual = self.torque - self.basis @ (along - left_out @ (left_out.T @ along))
        nothing = np.zeros((len(self.torque), 0))
        return Baseline(self.basis, left_out, nothing, residual, self.ends)
