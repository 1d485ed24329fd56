"""Evaluation of matrix functions on batches, compiled or by CasADi's virtual machine."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.compiled.kernel_source import CONSTANT_ARGUMENTS
from lieid_casadi.compiled.kernels import Kernels
from lieid_casadi.compiled.library import BatchArgument, BatchPlan, Kernel, KernelCall, Runtime
from lieid_casadi.expressions import model_functions
from lieid_casadi.expressions.model_functions import ModelFunctions, SparseFunction

Indices = NDArray[np.int64]

LAST_LEVEL_CACHE = 8 << 20  # bytes; larger results bypass the caches
BLOCK = 4096  # samples that the virtual machine evaluates at once
SAMPLES_PER_THREAD = 8192  # below it starting a thread takes longer than it saves
_ROLES = {"sin": 2, "cos": 3}


@dataclass(frozen=True)
class MatrixLayout:
    """The places of the values of a matrix."""

    shape: tuple[int, int]
    rows: Indices  # (nnz,) of each value, row after row, columns ascending
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


class CompiledEvaluation:
    """A matrix function of samples by compiled kernels; part k begins at ``first_columns[k]``."""

    def __init__(
        self,
        runtime: Runtime,
        kernels: Sequence[Kernel],
        first_columns: Sequence[int],
        shape: tuple[int, int],
    ) -> None:
        self.runtime = runtime
        # q first, of which the runtime takes sines
        given = dict.fromkeys(name for kernel in kernels for name, _ in kernel.arguments)
        names = sorted(given, key=lambda name: name != "q")
        self.names = {name: k for k, name in enumerate(names)}
        self.layout, _ = _side_by_side(kernels, first_columns, shape)
        self.calls = self._make_calls(kernels)
        self.arguments = _make_arguments(names, kernels)
        self.offsets, self.sources = _chunks(self.layout, runtime.lanes)

    def _make_calls(self, kernels: Sequence[Kernel]) -> ctypes.Array[KernelCall]:
        calls = (KernelCall * len(kernels))()
        start = self.layout.row_starts[:-1].copy()
        self._kept: list[Indices] = []  # keeps alive the memory that the calls point to
        for call, kernel in zip(calls, kernels, strict=True):
            arguments = np.array([self.names[name] for name, _ in kernel.arguments])
            starts = start.copy()
            start += np.bincount(kernel.rows, minlength=len(start))
            self._kept += [arguments, starts]
            call.kernel, call.argument_count = kernel.address, len(arguments)
            call.arguments, call.row_count = arguments.ctypes.data, len(starts)
            call.row_starts = starts.ctypes.data
        return calls

    def bind(self, values: Mapping[str, Array]) -> BoundKernels:
        """Return the function on given samples.

        ``values`` maps the names of arguments to arrays, (N, width) per sample or (width,) the same
        for all; arguments without a value are zero. The arrays are not copied.
        """
        return BoundKernels(self, values)


class BoundKernels:
    """Compiled kernels on given samples."""

    def __init__(self, evaluation: CompiledEvaluation, values: Mapping[str, Array]) -> None:
        self._evaluation, self._values = evaluation, values
        self._arguments = type(evaluation.arguments).from_buffer_copy(evaluation.arguments)
        for name, array in values.items():
            index = evaluation.names.get(name)
            if index is not None:
                argument = self._arguments[index]
                argument.data = _address(array)
                if array.ndim == 2:
                    argument.sample_bytes, argument.value_bytes = array.strides
        calls = evaluation.calls
        self._plan = BatchPlan(
            len(self._arguments), ctypes.addressof(self._arguments),
            len(calls), ctypes.addressof(calls),
        )  # fmt: skip
        self._address = ctypes.addressof(self._plan)

    def dense(self, out: Array, threads: int) -> None:
        """Write the matrices of all samples to ``out`` (N, rows, columns), C-contiguous."""
        e = self._evaluation
        size, start = e.layout.shape[0] * e.layout.shape[1], _address(out)
        chunks = (len(e.offsets), _address(e.offsets), _address(e.sources))
        past_caches = int(out.nbytes > LAST_LEVEL_CACHE)

        def run(part: tuple[int, int]) -> int:
            return e.runtime.dense(
                self._address, *part, start, size, e.layout.count, *chunks, past_caches
            )

        parts = slices(len(out), threads, e.runtime.lanes)
        if len(parts) == 1:
            failed = run(parts[0])
        else:
            with ThreadPoolExecutor(len(parts)) as pool:
                failed = min(pool.map(run, parts))
        if failed:
            raise MemoryError

    def columns(self, first: int, last: int, out: Array) -> None:
        """Write value k of the layout, of samples first … last − 1, to row k of ``out``."""
        e = self._evaluation
        step = out.strides[0] // 8
        if e.runtime.columns(self._address, first, last, _address(out), step, e.layout.count):
            raise MemoryError


class MachineEvaluation:
    """Evaluation by CasADi's virtual machine, on blocks of samples."""

    def __init__(
        self,
        functions: Sequence[SparseFunction],
        first_columns: Sequence[int],
        shape: tuple[int, int],
    ) -> None:
        self.functions = functions
        self.layout, self._order = _side_by_side(functions, first_columns, shape)

    def bind(self, values: Mapping[str, Array]) -> BoundMachine:
        """See `CompiledEvaluation.bind`."""
        return BoundMachine(self, values)

    def values(self, values: Mapping[str, Array], first: int, last: int) -> Array:
        """Return the values (nnz, last − first) of samples first … last − 1, in their order."""
        part = {name: x[first:last].T if x.ndim == 2 else x for name, x in values.items()}
        if "q" in part:
            part |= {"sin": np.sin(part["q"]), "cos": np.cos(part["q"])}
        found = [np.zeros((0, last - first))]
        for sparse in self.functions:
            f = sparse.function
            inputs = (
                part.get(f.name_in(k), np.zeros((f.size1_in(k), last - first)))
                for k in range(f.n_in())
            )
            found.append(np.asarray(f(*inputs).full()))
        return np.concatenate(found)[self._order]


class BoundMachine:
    """Functions of the virtual machine on given samples; see `BoundKernels`."""

    def __init__(self, evaluation: MachineEvaluation, values: Mapping[str, Array]) -> None:
        self._evaluation, self._values = evaluation, values

    def dense(self, out: Array, threads: int) -> None:
        """See `BoundKernels.dense`."""
        layout = self._evaluation.layout
        out[...] = 0.0
        for first in range(0, len(out), BLOCK):
            last = min(first + BLOCK, len(out))
            values = self._evaluation.values(self._values, first, last)
            out[first:last, layout.rows, layout.columns] = values.T

    def columns(self, first: int, last: int, out: Array) -> None:
        """See `BoundKernels.columns`."""
        out[:, : last - first] = self._evaluation.values(self._values, first, last)


Evaluation = CompiledEvaluation | MachineEvaluation


def evaluation_of(
    kernels: Kernels, names: Sequence[str], first_columns: Sequence[int], shape: tuple[int, int]
) -> Evaluation:
    """Return functions of a model side by side; by the virtual machine without a compiler."""
    compiled = kernels.get(names) if names else None
    if compiled is not None:
        return CompiledEvaluation(*compiled, first_columns, shape)
    functions = [getattr(kernels.functions, name) for name in names]
    return MachineEvaluation(functions, first_columns, shape)


def evaluation_of_one(name: str, sparse: SparseFunction) -> Evaluation:
    """Return a function that is none of a model's."""
    functions = cast(ModelFunctions, SimpleNamespace(**{name: sparse}))  # read as attributes
    return evaluation_of(Kernels(functions), [name], [0], sparse.shape)


def _make_arguments(names: Sequence[str], kernels: Sequence[Kernel]) -> ctypes.Array[BatchArgument]:
    """Return the arguments without their data."""
    arguments = (BatchArgument * len(names))()
    for argument, name in zip(arguments, names, strict=True):
        argument.width = max(dict(kernel.arguments).get(name, 0) for kernel in kernels)
        argument.role = 1 if name in CONSTANT_ARGUMENTS else _ROLES.get(name, 0)
        if name in _ROLES:
            # the runtime writes the sines and cosines of every q, even if no kernel reads q
            argument.width = arguments[0].width
    return arguments


def _side_by_side(
    parts: Sequence[Kernel | SparseFunction], first_columns: Sequence[int], shape: tuple[int, int]
) -> tuple[MatrixLayout, NDArray[np.intp]]:
    """Return the layout of parts side by side, and the order of their values in it."""
    none = np.zeros(0, dtype=np.int64)
    rows = np.concatenate([none, *(part.rows for part in parts)])
    moved = [part.columns + first for part, first in zip(parts, first_columns, strict=True)]
    columns = np.concatenate([none, *moved])
    order = np.lexsort((columns, rows))
    return MatrixLayout(shape, rows[order], columns[order]), order


def _address(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])  # half the time of array.ctypes.data


def _chunks(layout: MatrixLayout, lanes: int) -> tuple[Indices, NDArray[np.int32]]:
    """Return the pieces of ``lanes`` entries that hold values: offsets (c,), sources (c·lanes,).

    A piece that extends beyond the end of the matrix is written first: the zeros that it writes
    there are overwritten by the next matrix.
    """
    size = layout.shape[0] * layout.shape[1]
    padded = np.full(-(-size // lanes) * lanes, layout.count, dtype=np.int32)
    padded[layout.rows * layout.shape[1] + layout.columns] = np.arange(layout.count)
    pieces = padded.reshape(-1, lanes)
    used = np.flatnonzero((pieces != layout.count).any(axis=1))
    used = np.array(sorted(used, key=lambda c: (c + 1) * lanes <= size), dtype=np.int64)
    return used * lanes, np.ascontiguousarray(pieces[used]).ravel()


BUFFER_BYTES = 1 << 19  # half of a common second-level cache
PADDING = 8  # doubles between rows: strides of a power of two map to the same cache lines


class BaseBlocks:
    """Blocks of ``size`` samples of a base regressor.

    Each joint has only its structurally nonzero columns, so that joint i's block has no zeros of
    the links before it: ``columns[i]`` (p_i,) says which. Several threads may call `evaluate`, each
    with its buffer.
    """

    def __init__(
        self, evaluation: Evaluation, values: Mapping[str, Array], size: int | None = None
    ) -> None:
        layout = evaluation.layout
        self._bound = evaluation.bind(values)
        self._starts = [int(start) for start in layout.row_starts]
        self.columns = tuple(layout.columns[a:b] for a, b in pairwise(self._starts))
        self.size = size or max(64, BUFFER_BYTES // (8 * max(layout.count, 1)) // 64 * 64)

    def buffer(self) -> Array:
        """Return memory for one block, on a cache line's boundary."""
        rows, columns = self._starts[-1], self.size + PADDING
        memory = np.empty(rows * columns + PADDING)
        start = -memory.ctypes.data % 64 // 8
        return memory[start : start + rows * columns].reshape(rows, columns)

    def evaluate(self, first: int, last: int, buffer: Array) -> tuple[Array, ...]:
        """Return samples first … last − 1, at most ``size``, as one array (p_i, m) per joint.

        Rows are contiguous, so that the transpose is a Fortran-ordered matrix of m samples. The
        results are views of ``buffer``, which is from `buffer`.
        """
        self._bound.columns(first, last, buffer)
        return tuple(buffer[a:b, : last - first] for a, b in pairwise(self._starts))


BEFORE = "before_"  # prefix of arguments that belong to the sample before


def states_along(kernels: Kernels, signals: Mapping[str, Array]) -> Array:
    """Return the states (N, S) at every sample of one segment; see `model_functions.states_along`.

    ``kernels``: those of one lane, because each sample depends on the one before it; ``signals``:
    arrays by name.
    """
    compiled = kernels.get(["memory"])
    if compiled is None:
        return model_functions.states_along(kernels.functions, signals)
    runtime, (kernel,) = compiled
    assert runtime.states is not None
    model, samples = kernels.functions.model, len(signals["q"])
    states = np.empty((samples, len(model.states)))
    states[:1] = model.initial_states
    arrays = {name: np.ascontiguousarray(array) for name, array in signals.items()}
    nothing = np.zeros(max(width for _, width in kernel.arguments))
    pointers = (ctypes.c_void_p * len(kernel.arguments))()
    steps = np.zeros(len(kernel.arguments), dtype=np.int64)
    for k, (name, width) in enumerate(kernel.arguments):
        before = name.startswith(BEFORE) or name == "states"
        array = states if name == "states" else arrays.get(name.removeprefix(BEFORE))
        if array is None or width == 0:
            pointers[k] = nothing.ctypes.data
        elif name in CONSTANT_ARGUMENTS:
            pointers[k] = array.ctypes.data
        else:
            steps[k] = width
            pointers[k] = array.ctypes.data + (0 if before else array.strides[0])
    if runtime.states(
        kernel.address, len(steps), ctypes.addressof(pointers), steps.ctypes.data,
        states.shape[1], states.ctypes.data, samples,
    ):  # fmt: skip
        raise MemoryError
    return states


def slices(samples: int, threads: int, lanes: int) -> list[tuple[int, int]]:
    """Return first and last + 1 of the samples of each thread; all but the last whole lanes."""
    count = min(threads, samples // SAMPLES_PER_THREAD)
    if count <= 1:
        return [(0, samples)]
    step = -(-samples // (count * lanes)) * lanes
    return [(first, min(first + step, samples)) for first in range(0, samples, step)]
