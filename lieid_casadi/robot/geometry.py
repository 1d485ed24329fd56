"""Poses as homogeneous matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array


def relative(before: Array, after: Array) -> Array:
    """Return the pose (4, 4) ``after`` in the frame ``before``, both in the base frame."""
    return np.asarray(np.linalg.solve(before, after))


# cos(π/2) is 6e-17 in floating point; the zero that is meant keeps symbolic expressions small.
_ROUND_OFF = 1e-15


def pose(xyz: Sequence[float] | Array, rpy: Sequence[float] | Array) -> Array:
    """Return the homogeneous matrix (4, 4) of a position (3,) in m and roll, pitch, yaw in rad.

    The rotation is Rz(yaw)·Ry(pitch)·Rx(roll), as in URDF; entries that differ from 0 or ±1
    by round-off alone are exact.

    Examples
    --------
    >>> pose([0, 0, 0.3], [np.pi / 2, 0, 0])[:3, :3]
    array([[ 1.,  0.,  0.],
           [ 0.,  0., -1.],
           [ 0.,  1.,  0.]])
    """
    matrix, (roll, pitch, yaw) = np.eye(4), rpy
    matrix[:3, :3] = _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)
    matrix[:3, 3] = xyz
    return matrix + 0.0  # no -0.0


def roll_pitch_yaw(rotation: ArrayLike) -> Array:
    """Return roll, pitch, yaw (3,) of a rotation (3, 3); at pitch ±π/2 yaw is 0."""
    r = np.asarray(rotation, dtype=float)
    cosine = math.hypot(r[0, 0], r[1, 0])
    pitch = math.atan2(-r[2, 0], cosine)
    if cosine > 1e-9:
        return np.array(
            [math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])], dtype=float
        )
    return np.array([math.atan2(-r[1, 2], r[1, 1]), pitch, 0.0])


def _about(axis: int, angle: float) -> Array:
    j, k = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    cosine, sine = (_snap(value) for value in (math.cos(angle), math.sin(angle)))
    matrix[j, j] = matrix[k, k] = cosine
    matrix[k, j], matrix[j, k] = sine, -sine
    return matrix


def _snap(value: float) -> float:
    nearest = float(round(value))
    return nearest if abs(value - nearest) < _ROUND_OFF else value
