"""Checks of the arrays that a compiled model takes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ModelError

_FLOAT = np.dtype(np.float64)


def samples(name: str, values: ArrayLike, width: int, count: int | None = None) -> Array:
    """Return values as float64 (N, width), of any strides.

    ``name``: named in errors; ``values`` (N, width); ``count``: the N that is expected; any if left
    out.
    Raises `ModelError`: another shape, or not real numbers.
    """
    array = _real(name, values)
    if array.ndim != 2 or array.shape[1] != width or count not in (None, len(array)):
        rows = "N" if count is None else str(count)
        raise ModelError(f"{name}: shape {array.shape}; expected ({rows}, {width})")
    return array


def times(values: ArrayLike, count: int) -> Array:
    """Return times (N,) as (N, 1)."""
    array = _real("time", values)
    if array.shape not in ((count,), (count, 1)):
        raise ModelError(f"time: shape {array.shape}; expected ({count},)")
    return array.reshape(count, 1)


def constants(name: str, values: ArrayLike, width: int) -> Array:
    """Return values that are the same for every sample as contiguous float64.

    ``name``: named in errors; ``values`` (width,).
    """
    array = _real(name, values)
    if array.shape != (width,):
        raise ModelError(f"{name}: shape {array.shape}; expected ({width},)")
    return np.ascontiguousarray(array)


def output(out: object, shape: tuple[int, ...]) -> Array:
    """Return the array to write to: ``out`` if it fits, a new one if it is None."""
    if out is None:
        return np.empty(shape)
    if not isinstance(out, np.ndarray):
        raise ModelError(f"out: {type(out).__name__}; expected an array of float64")
    if out.dtype != np.float64:
        raise ModelError(f"out: dtype {out.dtype}; expected float64")
    if out.shape != shape:
        raise ModelError(f"out: shape {out.shape}; expected {shape}")
    if not (out.flags.c_contiguous and out.flags.aligned and out.flags.writeable):
        raise ModelError("out: expected a C-contiguous, writable array")
    return out


def _real(name: str, values: ArrayLike) -> Array:
    if isinstance(values, np.ndarray) and values.dtype is _FLOAT and values.flags.aligned:
        return values
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise ModelError(f"{name}: {error}") from None
    if array.dtype.kind not in "fiub":
        raise ModelError(f"{name}: dtype {array.dtype}; expected real numbers")
    return np.require(array, np.float64, "A")
