"""Screws, poses and gravity as arrays of numbers, or of numbers and CasADi symbols.

An array without symbols has dtype float. One with symbols has dtype object; its entries are floats
and scalar ``ca.SX`` expressions, so that NumPy's sums and products apply to both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import RobotError

Geometry = NDArray[Any]


def kind_of_symbols(value: Any) -> str:
    """Return ``SX``, ``MX`` or ``DM`` for a matrix of CasADi, else an empty string."""
    name = type(value).__name__
    return name if type(value).__module__.startswith("casadi") else ""


def geometry(value: Any, shape: tuple[int, ...], what: str) -> Geometry:
    """Return numbers and SX expressions as an array of a given shape.

    Parameters
    ----------
    value : array_like or ca.SX
        Numbers, an SX matrix, or nested sequences of numbers and scalar SX expressions.
    shape : tuple of int
        Expected shape; a matrix of one column is accepted for a vector.
    what : str
        Named in errors, such as ``joint 'elbow': screw``.

    Raises
    ------
    RobotError
        Another shape, or entries of another kind.
    """
    if isinstance(value, np.ndarray) and value.dtype == float and value.shape == shape:
        return value
    entries = _flat(value, what)
    if len(entries) != int(np.prod(shape)):
        expected = " × ".join(map(str, shape))
        raise RobotError(f"{what}: {len(entries)} numbers; expected {expected}")
    if all(isinstance(entry, float) for entry in entries):
        return np.array(entries, dtype=float).reshape(shape)
    array = np.empty(len(entries), dtype=object)
    for k, entry in enumerate(entries):
        array[k] = entry
    return array.reshape(shape)


def _flat(value: Any, what: str) -> list[Any]:
    """Return the entries row after row; constants as floats."""
    kind = kind_of_symbols(value)
    if kind == "MX":
        raise RobotError(f"{what}: MX symbols; expected SX, or Robot.from_screws, which takes both")
    if kind:
        rows, columns = value.shape
        cells = [value[i, j] for i in range(rows) for j in range(columns)]
        return [float(cell) if cell.is_constant() else cell for cell in cells]
    if isinstance(value, (list, tuple, np.ndarray)):
        return [entry for item in value for entry in _flat(item, what)]
    if isinstance(value, (str, bytes)) or value is None:
        raise RobotError(f"{what}: {value!r:.40}; expected numbers or SX expressions")
    try:
        return [float(value)]
    except (TypeError, ValueError):
        if hasattr(value, "__mul__"):
            return [value]  # of another algebra
        raise RobotError(f"{what}: {value!r:.40}; expected numbers or SX expressions") from None


def expressions(array: Geometry) -> list[Any]:
    """Return the entries that are not numbers."""
    return [x for x in array.flat if not isinstance(x, float)] if array.dtype == object else []


def relative(before: Geometry, after: Geometry) -> Geometry:
    """Return the pose (4, 4) ``after`` in the frame ``before``, both in the base frame."""
    if before.dtype == float and after.dtype == float:
        return np.asarray(np.linalg.solve(before, after))
    inverse = np.empty((4, 4), dtype=object)
    rotation = before[:3, :3].T
    inverse[:3, :3], inverse[:3, 3] = rotation, -rotation @ before[:3, 3]
    inverse[3] = [0.0, 0.0, 0.0, 1.0]
    return np.asarray(inverse @ after)
