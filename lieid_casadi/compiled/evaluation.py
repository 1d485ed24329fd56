"""Evaluation of a sparse matrix function on batches, compiled or by CasADi's virtual machine."""

from __future__ import annotations

import ctypes
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled.c_source import CONSTANT_ARGUMENTS
from lieid_casadi.compiled.library import Argument, Call, Kernel, Plan, Runtime
from lieid_casadi.functions import SparseFunction

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SAMPLES_PER_THREAD = 4096  # fewer are not worth a thread
LAST_LEVEL_CACHE = 8 << 20  # bytes; larger results are written past the caches
BLOCK = 4096  # samples that the virtual machine evaluates at once
_ROLES = {"sin": 2, "cos": 3}


@dataclass(frozen=True)
class Layout:
    """Where the values of a matrix (rows, columns) are.

    ``rows``, ``columns`` (nnz,) give the place of each value, row after row, columns ascending.
    """

    shape: tuple[int, int]
    rows: Indices
    columns: Indices

    @cached_property
    def row_starts(self) -> Indices:
        """Where each row's values begin, and the last one's end (rows + 1,)."""
        counts = np.bincount(self.rows, minlength=self.shape[0])
        return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)

    @property
    def count(self) -> int:
        """Number of values."""
        return len(self.rows)


class Evaluation(ABC):
    """A matrix function of samples, made of parts side by side.

    ``values`` maps the names of arguments to arrays, (N, width) per sample or (width,) the same
    for all; names left out are zero.
    """

    layout: Layout

    @abstractmethod
    def dense(self, values: Mapping[str, Array], out: Array, threads: int) -> None:
        """Write the matrices of all samples to ``out`` (N, rows, columns), C-contiguous."""

    @abstractmethod
    def columns(self, values: Mapping[str, Array], first: int, last: int, out: Array) -> None:
        """Write the values of samples first … last − 1 to ``out`` (nnz, ≥ last − first)."""


class CompiledEvaluation(Evaluation):
    """By compiled kernels; part k begins at column ``first_columns[k]``."""

    def __init__(
        self,
        runtime: Runtime,
        kernels: Sequence[Kernel],
        first_columns: Sequence[int],
        shape: tuple[int, int],
    ) -> None:
        self.runtime = runtime
        self.kernels = kernels
        self.names = _names(kernels)
        self.layout, _ = _side_by_side(kernels, first_columns, shape)
        self._calls = self._make_calls()
        self._offsets, self._sources = _chunks(self.layout, runtime.lanes)

    def _make_calls(self) -> ctypes.Array[Call]:
        calls = (Call * len(self.kernels))()
        start = self.layout.row_starts[:-1].copy()
        self._kept: list[Indices] = []  # memory that the calls point to
        for call, kernel in zip(calls, self.kernels, strict=True):
            arguments = np.array([self.names.index(name) for name, _ in kernel.arguments])
            starts = start.copy()
            start += np.bincount(kernel.rows, minlength=len(start))
            self._kept += [arguments, starts]
            call.kernel, call.argument_count = kernel.address, len(arguments)
            call.arguments, call.row_count = arguments.ctypes.data, len(starts)
            call.row_starts = starts.ctypes.data
        return calls

    def _plan(self, values: Mapping[str, Array]) -> tuple[Plan, ctypes.Array[Argument]]:
        widths = dict(pair for kernel in self.kernels for pair in kernel.arguments)
        arguments = (Argument * len(self.names))()
        for argument, name in zip(arguments, self.names, strict=True):
            argument.width = widths[name]
            argument.role = 1 if name in CONSTANT_ARGUMENTS else _ROLES.get(name, 0)
            array = values.get(name)
            if array is not None:
                argument.data = array.ctypes.data
                if array.ndim == 2:
                    argument.sample_bytes, argument.value_bytes = array.strides
        plan = Plan(
            len(arguments), ctypes.addressof(arguments), len(self._calls),
            ctypes.addressof(self._calls),
        )  # fmt: skip
        return plan, arguments

    def dense(self, values: Mapping[str, Array], out: Array, threads: int) -> None:
        """See `Evaluation`."""
        samples, size = len(out), self.layout.shape[0] * self.layout.shape[1]
        plan, _kept = self._plan(values)
        past_caches = int(out.nbytes > LAST_LEVEL_CACHE)

        def run(first: int, last: int) -> int:
            return self.runtime.dense(
                ctypes.addressof(plan), first, last, out.ctypes.data, size, self.layout.count,
                len(self._offsets), self._offsets.ctypes.data, self._sources.ctypes.data,
                past_caches,
            )  # fmt: skip

        slices = _slices(samples, threads, self.runtime.lanes)
        if len(slices) == 1:
            failed = run(*slices[0])
        else:
            with ThreadPoolExecutor(len(slices)) as pool:
                failed = min(pool.map(lambda s: run(*s), slices))
        if failed:
            raise MemoryError

    def columns(self, values: Mapping[str, Array], first: int, last: int, out: Array) -> None:
        """See `Evaluation`."""
        plan, _kept = self._plan(values)
        step = out.strides[0] // out.itemsize
        if self.runtime.columns(
            ctypes.addressof(plan), first, last, out.ctypes.data, step, self.layout.count
        ):
            raise MemoryError


class MachineEvaluation(Evaluation):
    """By CasADi's virtual machine, on blocks of samples."""

    def __init__(
        self,
        functions: Sequence[SparseFunction],
        first_columns: Sequence[int],
        shape: tuple[int, int],
    ) -> None:
        self.functions = functions
        self.layout, self._order = _side_by_side(functions, first_columns, shape)

    def dense(self, values: Mapping[str, Array], out: Array, threads: int) -> None:
        """See `Evaluation`; one thread."""
        out[...] = 0.0
        for first in range(0, len(out), BLOCK):
            last = min(first + BLOCK, len(out))
            out[first:last, self.layout.rows, self.layout.columns] = self._values(
                values, first, last
            ).T

    def columns(self, values: Mapping[str, Array], first: int, last: int, out: Array) -> None:
        """See `Evaluation`."""
        out[:, : last - first] = self._values(values, first, last)

    def _values(self, values: Mapping[str, Array], first: int, last: int) -> Array:
        """Return the values (nnz, last − first) in the layout's order."""
        parts = []
        for sparse in self.functions:
            inputs = [
                self._input(values, sparse, k, first, last) for k in range(sparse.function.n_in())
            ]
            parts.append(np.asarray(sparse.function(*inputs).full()))
        return np.concatenate(parts)[self._order]

    def _input(
        self, values: Mapping[str, Array], sparse: SparseFunction, k: int, first: int, last: int
    ) -> Array:
        name, width = sparse.function.name_in(k), sparse.function.size1_in(k)
        if name in _ROLES:
            return np.asarray((np.sin if name == "sin" else np.cos)(values["q"][first:last])).T
        array = values.get(name)
        if array is None:
            return np.zeros((width, last - first))
        return array[first:last].T if array.ndim == 2 else array


def _side_by_side(
    parts: Sequence[Kernel | SparseFunction],
    first_columns: Sequence[int],
    shape: tuple[int, int],
) -> tuple[Layout, NDArray[np.intp]]:
    """Return the layout of parts together, and which of their values comes where in it."""
    rows = np.concatenate([part.rows for part in parts]).astype(np.int64)
    columns = np.concatenate(
        [part.columns + first for part, first in zip(parts, first_columns, strict=True)]
    ).astype(np.int64)
    order = np.lexsort((columns, rows))
    return Layout(shape, rows[order], columns[order]), order


def default_threads() -> int:
    """Return two, or one where the program may use only one processor."""
    return min(2, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2)


def _names(kernels: Sequence[Kernel]) -> list[str]:
    """Return the arguments of all kernels; q first, whose sines the runtime takes."""
    names = [name for kernel in kernels for name, _ in kernel.arguments]
    return sorted(dict.fromkeys(names), key=lambda name: name != "q")


def _slices(samples: int, threads: int, lanes: int) -> list[tuple[int, int]]:
    """Return slices of samples, whole groups of lanes but the last."""
    count = max(1, min(threads, samples // SAMPLES_PER_THREAD))
    step = -(-samples // (count * lanes)) * lanes
    starts = range(0, max(samples, 1), max(step, 1))
    return [(first, min(first + step, samples)) for first in starts]


def _chunks(layout: Layout, lanes: int) -> tuple[Indices, NDArray[np.int32]]:
    """Return the pieces of ``lanes`` entries that hold values: offsets (c,), sources (c·lanes,).

    A piece that reaches over the matrix's end comes first: what it writes there, zeros, is
    overwritten by the next matrix.
    """
    size = layout.shape[0] * layout.shape[1]
    padded = np.full(-(-size // lanes) * lanes, layout.count, dtype=np.int32)
    padded[layout.rows * layout.shape[1] + layout.columns] = np.arange(layout.count)
    pieces = padded.reshape(-1, lanes)
    used = np.flatnonzero((pieces != layout.count).any(axis=1))
    used = np.array(sorted(used, key=lambda c: (c + 1) * lanes <= size), dtype=np.int64)
    return used * lanes, np.ascontiguousarray(pieces[used]).ravel()
