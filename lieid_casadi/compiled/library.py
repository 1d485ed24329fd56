"""Loading of compiled libraries: kernels, and the runtime that runs them."""

from __future__ import annotations

import _ctypes
import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import CompilerError

Indices = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Kernel:
    """One matrix function, compiled.

    Attributes
    ----------
    address : int
        Of ``lieid_kernel``.
    arguments : tuple of (name, width)
    shape : (rows, columns) of the matrix
    rows, columns : (nnz,) int
        Place of each value, row after row, columns ascending.
    """

    library: ctypes.CDLL
    address: int
    arguments: tuple[tuple[str, int], ...]
    shape: tuple[int, int]
    rows: Indices
    columns: Indices


def load_kernel(path: Path) -> Kernel:
    """Load a kernel; `CompilerError` if the system refuses it or it lacks a symbol."""
    with _opened(path) as library:
        return _kernel(library)


def _kernel(library: ctypes.CDLL) -> Kernel:
    rows, columns, count = (ctypes.c_int32 * 3).in_dll(library, "lieid_shape")
    names = ctypes.cast(library.lieid_arguments, ctypes.c_char_p).value or b""
    arguments = tuple(
        (name, int(width)) for name, _, width in (a.partition(":") for a in names.decode().split())
    )
    address = ctypes.cast(library.lieid_kernel, ctypes.c_void_p).value
    assert address is not None
    return Kernel(
        library,
        address,
        arguments,
        (rows, columns),
        _indices(library, "lieid_rows", count),
        _indices(library, "lieid_columns", count),
    )


def _indices(library: ctypes.CDLL, name: str, count: int) -> Indices:
    return np.array((ctypes.c_int32 * count).in_dll(library, name), dtype=np.int32)


class BatchArgument(ctypes.Structure):
    """``lieid_argument`` of ``codegen/lieid_batch.c``."""

    _fields_ = (
        ("data", ctypes.c_void_p),
        ("width", ctypes.c_int64),
        ("sample_bytes", ctypes.c_int64),
        ("value_bytes", ctypes.c_int64),
        ("role", ctypes.c_int64),
    )


class KernelCall(ctypes.Structure):
    """``lieid_call``."""

    _fields_ = (
        ("kernel", ctypes.c_void_p),
        ("argument_count", ctypes.c_int64),
        ("arguments", ctypes.c_void_p),
        ("row_count", ctypes.c_int64),
        ("row_starts", ctypes.c_void_p),
    )


class BatchPlan(ctypes.Structure):
    """``lieid_plan``."""

    _fields_ = (
        ("argument_count", ctypes.c_int64),
        ("arguments", ctypes.c_void_p),
        ("call_count", ctypes.c_int64),
        ("calls", ctypes.c_void_p),
    )


@dataclass(frozen=True, eq=False)
class Runtime:
    """``codegen/lieid_batch.c``, compiled: its functions, which release the GIL.

    ``states`` is there with one lane only.
    """

    lanes: int
    dense: Callable[..., int]
    columns: Callable[..., int]
    states: Callable[..., int] | None


def load_runtime(path: Path) -> Runtime:
    """Load the runtime; `CompilerError` if the system refuses it or it lacks a symbol."""
    with _opened(path) as library:
        return _runtime(library)


def _runtime(library: ctypes.CDLL) -> Runtime:
    pointer, whole = ctypes.c_void_p, ctypes.c_int64
    dense, columns = library.lieid_dense, library.lieid_columns
    dense.argtypes = [
        pointer, whole, whole, pointer, whole, whole, whole, pointer, pointer, ctypes.c_int,
    ]  # fmt: skip
    columns.argtypes = [pointer, whole, whole, pointer, whole, whole]
    count = library.lieid_lane_count
    count.restype = whole
    lanes, states = int(count()), None
    if lanes == 1:
        states = library.lieid_states
        states.argtypes = [pointer, whole, pointer, pointer, whole, pointer, whole]
    return Runtime(lanes, dense, columns, states)


@dataclass(frozen=True, eq=False)
class Reducer:
    """``codegen/lieid_reduce.c``, compiled: its function, which releases the GIL."""

    matrix: Callable[..., None]


def load_reducer(path: Path) -> Reducer:
    """Load the reducer; `CompilerError` if the system refuses it or it lacks a symbol."""
    with _opened(path) as library:
        return _reducer(library)


def _reducer(library: ctypes.CDLL) -> Reducer:
    pointer, whole = ctypes.c_void_p, ctypes.c_int64
    matrix = library.lieid_reduce_matrix
    matrix.argtypes = [pointer, whole, whole, whole, pointer, pointer]
    matrix.restype = None
    return Reducer(matrix)


@contextmanager
def _opened(path: Path) -> Iterator[ctypes.CDLL]:
    """Open a library, and close it if a symbol is missing: a new file may take its path."""
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise CompilerError(f"{path} cannot be loaded: {error}") from None
    try:
        yield library
    except (AttributeError, ValueError) as error:  # from a function, from a variable
        _ctypes.dlclose(library._handle)
        raise CompilerError(f"{path} cannot be used: {error}") from None
