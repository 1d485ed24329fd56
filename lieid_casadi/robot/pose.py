"""Poses as URDF and YAML write them: a position and roll, pitch, yaw."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.robot.geometry import Geometry, kind_of_symbols

# cos(π/2) is 6e-17 in floating point; the zero that is meant keeps symbolic expressions small.
_ROUND_OFF = 1e-15


def pose(xyz: Any, rpy: Any) -> Geometry:
    """Return the homogeneous matrix (4, 4) of a position (m) and roll, pitch, yaw (rad).

    Both (3,) are numbers or contain scalar SX or MX expressions.

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
