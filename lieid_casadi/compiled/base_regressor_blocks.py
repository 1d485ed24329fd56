"""The base regressor in blocks that fit in cache, joint by joint, for reductions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.compiled.batch_evaluation import Evaluation
from lieid_casadi.compiled.library import Runtime

BUFFER_BYTES = 1 << 19  # half of a common second-level cache
PADDING = 8  # doubles between rows: strides of a power of two map to the same cache lines


class BaseBlocks:
    """Blocks of samples of a base regressor.

    Each joint has only its structurally nonzero columns, so that joint i's block has no zeros of
    the links before it. Iterate, or call `evaluate` from several threads with a buffer each.

    Attributes
    ----------
    columns : tuple of (p_i,) int
        Which of the base regressor's columns each joint has, ascending.
    starts : (n + 1,) int
        Where each joint's values begin among those of one sample.
    samples : int
    size : int
        Samples per block.

    Examples
    --------
    >>> import lieid_casadi as lieid, numpy as np
    >>> arm = lieid.compile(lieid.Model(lieid.robots.two_link(), effects=["viscous"]))
    >>> q = np.zeros((1000, 2))
    >>> blocks = arm.base_blocks(q, q, q, size=400)
    >>> [(part.start, part.stop, joints[1].shape) for part, joints in blocks]
    [(0, 400, (4, 400)), (400, 800, (4, 400)), (800, 1000, (4, 200))]
    """

    def __init__(
        self,
        evaluation: Evaluation,
        values: Mapping[str, Array],
        samples: int,
        size: int | None = None,
    ) -> None:
        layout = evaluation.layout
        self._bound = evaluation.bind(values)
        self._starts = [int(start) for start in layout.row_starts]
        self.starts = layout.row_starts
        self.columns = tuple(
            layout.columns[first:last]
            for first, last in zip(self._starts[:-1], self._starts[1:], strict=True)
        )
        self.samples = samples
        self.size = size or max(64, BUFFER_BYTES // (8 * max(layout.count, 1)) // 64 * 64)

    @property
    def compiled(self) -> tuple[Runtime, int] | None:
        """The runtime and the plan's address, None where the virtual machine evaluates."""
        return self._bound.compiled

    def buffer(self) -> Array:
        """Return memory for one block, on a cache line's boundary."""
        rows, columns = self._starts[-1], self.size + PADDING
        memory = np.empty(rows * columns + PADDING)
        start = -memory.ctypes.data % 64 // 8
        return memory[start : start + rows * columns].reshape(rows, columns)

    def evaluate(self, first: int, last: int, buffer: Array) -> tuple[Array, ...]:
        """Return some samples as one array (p_i, m) per joint, m = last − first.

        Rows are contiguous, so that the transpose is a Fortran-ordered matrix of m samples.

        Parameters
        ----------
        first, last : int
            Samples first … last − 1, at most ``size``.
        buffer : array
            From `buffer`; the results are views of it.
        """
        self._bound.columns(first, last, buffer)
        ends = zip(self._starts[:-1], self._starts[1:], strict=True)
        return tuple(buffer[start:end, : last - first] for start, end in ends)

    def __iter__(self) -> Iterator[tuple[slice, tuple[Array, ...]]]:
        buffer = self.buffer()
        for first in range(0, self.samples, self.size):
            last = min(first + self.size, self.samples)
            yield slice(first, last), self.evaluate(first, last, buffer)
