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
    """One matrix function, compiled."""

    library: ctypes.CDLL
    address: int  # of ``lieid_kernel``
    arguments: tuple[tuple[str, int], ...]  # names and widths
    shape: tuple[int, int]
    rows: Indices  # (nnz,) place of each value, row after row, columns ascending
    columns: Indices


def load_kernel(path: Path) -> Kernel:
    """Load a kernel; `CompilerError` if the system refuses it or it lacks a symbol."""
    with _opened(path) as library:
        rows, columns, count = (ctypes.c_int32 * 3).in_dll(library, "lieid_shape")
        names = ctypes.cast(library.lieid_arguments, ctypes.c_char_p).value or b""
        arguments = (argument.partition(":") for argument in names.decode().split())
        address = ctypes.cast(library.lieid_kernel, ctypes.c_void_p).value
        assert address is not None
        places = (
            np.array((ctypes.c_int32 * count).in_dll(library, name), dtype=np.int32)
            for name in ("lieid_rows", "lieid_columns")
        )
        widths = tuple((name, int(width)) for name, _, width in arguments)
        return Kernel(library, address, widths, (rows, columns), *places)


POINTER, WHOLE = ctypes.c_void_p, ctypes.c_int64


class BatchArgument(ctypes.Structure):
    """``lieid_argument`` of ``codegen/lieid_batch.c``."""

    _fields_ = (
        ("data", POINTER), ("width", WHOLE), ("sample_bytes", WHOLE), ("value_bytes", WHOLE),
        ("role", WHOLE),
    )  # fmt: skip


class KernelCall(ctypes.Structure):
    """``lieid_call``."""

    _fields_ = (
        ("kernel", POINTER), ("argument_count", WHOLE), ("arguments", POINTER),
        ("row_count", WHOLE), ("row_starts", POINTER),
    )  # fmt: skip


class BatchPlan(ctypes.Structure):
    """``lieid_plan``."""

    _fields_ = (
        ("argument_count", WHOLE), ("arguments", POINTER), ("call_count", WHOLE), ("calls", POINTER)
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Runtime:
    """``codegen/lieid_batch.c``, compiled: its functions, which release the GIL."""

    lanes: int
    dense: Callable[..., int]
    columns: Callable[..., int]
    states: Callable[..., int] | None  # with one lane only


def load_runtime(path: Path) -> Runtime:
    """Load the runtime; `CompilerError` if the system refuses it or it lacks a symbol."""
    with _opened(path) as library:
        dense, columns = library.lieid_dense, library.lieid_columns
        dense.argtypes = [
            POINTER, WHOLE, WHOLE, POINTER, WHOLE, WHOLE, WHOLE, POINTER, POINTER, ctypes.c_int,
        ]  # fmt: skip
        columns.argtypes = [POINTER, WHOLE, WHOLE, POINTER, WHOLE, WHOLE]
        count = library.lieid_lane_count
        count.restype = WHOLE
        lanes, states = int(count()), None
        if lanes == 1:
            states = library.lieid_states
            states.argtypes = [POINTER, WHOLE, POINTER, POINTER, WHOLE, POINTER, WHOLE]
        return Runtime(lanes, dense, columns, states)


Reducer = Callable[..., None]


def load_reducer(path: Path) -> Reducer:
    """Return the function of ``codegen/lieid_reduce.c``; `CompilerError` as `load_runtime`."""
    with _opened(path) as library:
        reduce: Reducer = library.lieid_reduce_matrix
        library.lieid_reduce_matrix.argtypes = [POINTER, WHOLE, WHOLE, WHOLE, POINTER, POINTER]
        library.lieid_reduce_matrix.restype = None
        return reduce


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
