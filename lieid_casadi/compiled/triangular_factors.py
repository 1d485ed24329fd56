"""Triangular factors of rows that arrive in blocks (TSQR), by Householder reflections.

The factor of all rows is the factor of [factor so far; next block] (Demmel, Grigori, Hoemmen,
Langou, "Communication-optimal parallel and sequential QR and LU factorizations", SIAM J. Sci.
Comput. 2012). Compiled code computes it in cache; LAPACK does so without a compiler. No Gram matrix
is formed, which would square the condition number.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import qr

from lieid_casadi.arrays import Array
from lieid_casadi.compiled.kernels import reducer

BLOCK = 512  # rows reduced at once
PADDING = 8  # doubles between columns, see `blocks`
MOST_LANES = 8


def triangular(matrix: Array) -> Array:
    """Return R of the QR factorization, at most square."""
    if not len(matrix):
        return np.zeros((0, matrix.shape[1]))
    (r,) = qr(matrix, mode="r", check_finite=False)
    return np.asarray(r[: matrix.shape[1]])


class Triangle:
    """Triangular factor ``r`` (k, k) of rows added piece by piece: rᵀ·r is their Gram matrix."""

    def __init__(self, columns: int) -> None:
        self.r = np.zeros((columns, columns))
        self._reduce = reducer()
        self._block = np.zeros((columns, BLOCK + PADDING))
        self._pointers = np.zeros(columns, dtype=np.int64)

    def add(self, *parts: Array, weights: Array | None = None) -> None:
        """Add rows: ``parts`` (m, …) side by side, multiplied by ``weights`` (m,) row by row."""
        wide = [part if part.ndim == 2 else part[:, None] for part in parts]
        for first in range(0, len(wide[0]), BLOCK):
            rows = slice(first, first + BLOCK)
            self._add([part[rows] for part in wide], None if weights is None else weights[rows])

    def _add(self, parts: Sequence[Array], weights: Array | None) -> None:
        count, column = len(parts[0]), 0
        block = self._block
        for part in parts:
            block[column : column + part.shape[1], :count] = part.T
            column += part.shape[1]
        if weights is not None:
            block[:, :count] *= weights
        if self._reduce is None:
            small = triangular(np.vstack([self.r, block[:, :count].T]))
            self.r = np.triu(small)
            return
        block[:, count : count + MOST_LANES] = 0.0
        self._reduce(
            block.ctypes.data, count, len(block), block.shape[1],
            self._pointers.ctypes.data, self.r.ctypes.data,
        )  # fmt: skip
