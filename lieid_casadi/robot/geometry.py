"""Screws, poses and gravity as arrays of numbers, or of numbers and CasADi symbols.

An array without symbols has dtype float. One with symbols has dtype object; its entries are floats
and scalar ``ca.SX`` expressions, so that NumPy's sums and products apply to both.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.errors import RobotError

Geometry = NDArray[Any]


def kind_of_symbols(value: Any) -> str:
    """Return ``SX``, ``MX`` or ``DM`` for a matrix of CasADi, else an empty string."""
    name = type(value).__name__
    return name if type(value).__module__.startswith("casadi") else ""


def geometry(value: Any, shape: tuple[int, ...], what: str) -> Geometry:
    """Return numbers and SX expressions as an array; ``what`` is named in errors.

    A matrix of one column is accepted for a vector.
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
        raise RobotError(f"{what}: MX symbols; expected numbers or SX symbols")
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


# cos(π/2) is 6e-17 in floating point; the zero that is meant keeps symbolic expressions small.
_ROUND_OFF = 1e-15


def pose(xyz: Any, rpy: Any) -> Geometry:
    """Return the homogeneous matrix (4, 4) of a position (m) and roll, pitch, yaw (rad).

    Both (3,) are numbers or contain scalar SX expressions.

    The rotation is Rz(yaw)·Ry(pitch)·Rx(roll), as in URDF; entries that differ from 0 or ±1
    by round-off alone are exact.

    Examples
    --------
    >>> pose([0, 0, 0.3], [np.pi / 2, 0, 0])[:3, :3]
    array([[ 1.,  0.,  0.],
           [ 0.,  0., -1.],
           [ 0.,  1.,  0.]])
    """
    position, angles = ([x[k] for k in range(3)] for x in (xyz, rpy))
    with_symbols = any(kind_of_symbols(x) for x in (*position, *angles))
    matrix = np.eye(4).astype(object if with_symbols else float)
    roll, pitch, yaw = angles
    matrix[:3, :3] = _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)
    for k in range(3):
        matrix[k, 3] = position[k]
    return matrix + 0.0  # no -0.0


def roll_pitch_yaw(rotation: ArrayLike) -> NDArray[np.float64]:
    """Return roll, pitch, yaw (3,) in rad of a rotation matrix (3, 3); inverse of `pose`.

    At pitch ±π/2, where only a combination of roll and yaw is determined, yaw is 0.
    """
    r = np.asarray(rotation, dtype=float)
    cosine = math.hypot(r[0, 0], r[1, 0])
    pitch = math.atan2(-r[2, 0], cosine)
    if cosine > 1e-9:
        return np.array(
            [math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])], dtype=float
        )
    return np.array([math.atan2(-r[1, 2], r[1, 1]), pitch, 0.0])


def _about(axis: int, angle: Any) -> Geometry:
    j, k = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    if kind_of_symbols(angle):
        import casadi as ca

        cosine, sine = ca.cos(angle), ca.sin(angle)
        matrix = matrix.astype(object)
    else:
        cosine, sine = (_snap(value) for value in (math.cos(angle), math.sin(angle)))
    matrix[j, j] = matrix[k, k] = cosine
    matrix[k, j], matrix[j, k] = sine, -sine
    return matrix


def _snap(value: float) -> float:
    nearest = float(round(value))
    return nearest if abs(value - nearest) < _ROUND_OFF else value
