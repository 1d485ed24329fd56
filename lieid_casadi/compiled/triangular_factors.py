"""Triangular factors of rows that arrive in blocks (TSQR), by Householder reflections.

The factor of all rows is the factor of [factor so far; next block] (Demmel, Grigori, Hoemmen,
Langou, "Communication-optimal parallel and sequential QR and LU factorizations", SIAM J. Sci.
Comput. 2012). Compiled code computes it in cache; LAPACK does so without a compiler. No Gram matrix
is formed, which would square the condition number.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from scipy.linalg import qr

from lieid_casadi.arrays import Array
from lieid_casadi.compiled.base_regressor_blocks import BaseBlocks
from lieid_casadi.compiled.kernels import reducer
from lieid_casadi.compiled.library import Reducer, Runtime

BLOCK = 512  # rows reduced at once
PADDING = 8  # doubles between columns, see `blocks`
MOST_LANES = 8
SAMPLES_PER_THREAD = 4096  # below it starting a thread takes longer than it saves


def triangular(matrix: Array) -> Array:
    """Return R of the QR factorization, at most square."""
    if not len(matrix):
        return np.zeros((0, matrix.shape[1]))
    (r,) = qr(matrix, mode="r", check_finite=False)
    return np.asarray(r[: matrix.shape[1]])


class Triangle:
    """Triangular factor of rows added piece by piece.

    Attributes
    ----------
    r : (k, k)
        Upper triangular: rᵀ·r is the Gram matrix of the rows so far, which is never formed.

    Examples
    --------
    >>> triangle = Triangle(2)
    >>> triangle.add(np.array([[3.0, 0.0], [4.0, 2.0]]))
    >>> np.abs(triangle.r).round(12)
    array([[5. , 1.6],
           [0. , 1.2]])
    """

    def __init__(self, columns: int) -> None:
        self.r = np.zeros((columns, columns))
        self._reducer: Reducer | None = reducer()
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
        if self._reducer is None:
            small = triangular(np.vstack([self.r, block[:, :count].T]))
            self.r = np.triu(small)
            return
        block[:, count : count + MOST_LANES] = 0.0
        self._reducer.matrix(
            block.ctypes.data, count, len(block), block.shape[1],
            self._pointers.ctypes.data, self.r.ctypes.data,
        )  # fmt: skip


def block_triangles(blocks: BaseBlocks, torque: Array, threads: int) -> list[Array]:
    """Return the factor (p_i + 1, p_i + 1) of [columns | torque] of each joint.

    ``torque`` (N, n): N·m; ``threads``: each takes one stretch of the samples.
    """
    count = max(min(threads, blocks.samples // SAMPLES_PER_THREAD), 1)
    edges = [blocks.samples * k // count for k in range(count + 1)]
    parts = list(pairwise(edges))
    if count == 1:
        return _reduced(blocks, torque, *parts[0])
    with ThreadPoolExecutor(count) as pool:
        done = list(pool.map(lambda part: _reduced(blocks, torque, *part), parts))
    return [_merged(factors) for factors in zip(*done, strict=True)]


def _merged(factors: Sequence[Array]) -> Array:
    triangle = Triangle(factors[0].shape[1])
    for factor in factors:
        triangle.add(factor)
    return triangle.r


def _reduced(blocks: BaseBlocks, torque: Array, first: int, last: int) -> list[Array]:
    compiled = reducer()
    if blocks.compiled is None or compiled is None:
        return _by_lapack(blocks, torque, first, last)
    runtime, plan = blocks.compiled
    factors = [np.zeros((len(columns) + 1,) * 2) for columns in blocks.columns]
    pointers = np.array([factor.ctypes.data for factor in factors], dtype=np.int64)
    if compiled.blocks(
        _address_of_columns(runtime), plan, first, last, blocks.size, len(factors),
        blocks.starts.ctypes.data, torque.ctypes.data, *torque.strides, pointers.ctypes.data,
    ):  # fmt: skip
        raise MemoryError
    return factors


def _by_lapack(blocks: BaseBlocks, torque: Array, first: int, last: int) -> list[Array]:
    triangles = [Triangle(len(columns) + 1) for columns in blocks.columns]
    buffer = blocks.buffer()
    for start in range(first, last, blocks.size):
        end = min(start + blocks.size, last)
        for j, values in enumerate(blocks.evaluate(start, end, buffer)):
            triangles[j].add(values.T, torque[start:end, j])
    return [triangle.r for triangle in triangles]


def _address_of_columns(runtime: Runtime) -> int:
    address = ctypes.cast(runtime.columns, ctypes.c_void_p).value  # type: ignore[arg-type]
    assert address is not None
    return address
