"""Columns of rival effects along a motion, stacked over all joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

Array = NDArray[np.float64]
RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class StackedColumns:
    """Columns along a motion, the rows of all joints stacked and weighted.

    The squared length of a vector is the noncentrality that one period contributes.

    Attributes
    ----------
    common : (R, r)
        Orthonormal basis of the base columns and of the effects that all rivals share.
    columns : tuple of (G, R, c)
        Of each rival, at the shape parameters of its grid.
    """

    common: Array
    columns: tuple[Array, ...]

    def outside_model(self, columns: Array) -> Array:
        """Return the part of columns (R, c) outside the common span.

        The projection is applied twice, against rounding.
        """
        for _ in range(2):
            columns = columns - self.common @ (self.common.T @ columns)
        return columns

    @cached_property
    def remaining_columns(self) -> tuple[tuple[Array, ...], ...]:
        """Columns of each rival outside the common span, at each point of its grid."""
        return tuple(tuple(self.outside_model(c) for c in each) for each in self.columns)

    def unexplained(self, true: int, rival: int, coefficients: Array) -> Array:
        """Return the weighted torque (R,) of one effect that the best refit of another leaves.

        Parameters
        ----------
        true, rival : int
            Indices of the effects.
        coefficients : (c,)
            Of the true effect.
        """
        torque = self.remaining_columns[true][0] @ coefficients
        best: Array = torque
        for own in self.remaining_columns[rival]:
            scale = np.linalg.norm(own, axis=0)
            basis = span_basis(own / np.where(scale > 0.0, scale, 1.0))
            left = torque - basis @ (basis.T @ torque)
            if left @ left < best @ best:
                best = left
        return best


def span_basis(columns: Array) -> Array:
    """Return an orthonormal basis of columns (R, k) of about unit length."""
    basis, triangle, _ = qr(columns, mode="economic", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    return np.asarray(basis[:, sizes > RANK_TOLERANCE * max(float(sizes.max(initial=0.0)), 1e-300)])
