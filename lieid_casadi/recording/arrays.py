"""The array type of recordings, and hashes of arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def read_only(values: ArrayLike) -> Array:
    """Return a read-only float64 array, because recordings are shared.

    A copy, unless the memory is read-only already.
    """
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and _frozen(values):
        return values
    array = np.array(values, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


def _frozen(values: Array) -> bool:
    """Return whether an array and every array that it is a view of are read-only."""
    owner: object = values
    while isinstance(owner, np.ndarray):
        if owner.flags.writeable:
            return False
        owner = owner.base
    return owner is None and bool(values.flags.c_contiguous)


def hash_of_arrays(arrays: Iterable[Any]) -> str:
    """Return the sha256 over shapes and bytes of the arrays, in order; None counts too."""
    digest = hashlib.sha256()
    for array in arrays:
        if array is None:
            digest.update(b"none;")
        elif isinstance(array, tuple):
            digest.update(repr(array).encode())
        else:
            digest.update(repr(array.shape).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
