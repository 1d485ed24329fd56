"""Poses as homogeneous matrices, and the inertia of one rigid body in its parametrizations.

Link parameters are ordered as in Pinocchio and refer to the link frame's origin:
``m, m·cx, m·cy, m·cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

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


LINK_PARAMETER_NAMES = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
LINK_PARAMETER_UNITS = ("kg",) + ("kg·m",) * 3 + ("kg·m²",) * 6
PRINTED = 0.02  # error of the moments of a thin body that are printed with two digits


@dataclass(frozen=True, eq=False)
class BodyInertia:
    """Mass (kg), centre of mass (3,) (m) and inertia (3, 3) about it (kg·m²), link axes."""

    mass: float
    com: Array
    inertia: Array


def symmetric(six: ArrayLike) -> Array:
    """Return the symmetric (3, 3) matrix of ``Ixx, Ixy, Iyy, Ixz, Iyz, Izz``."""
    xx, xy, yy, xz, yz, zz = np.asarray(six, dtype=float)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def link_parameters(mass: float, com: ArrayLike, inertia_about_com: ArrayLike) -> Array:
    """Return the ten link parameters (10,); the inertia (3, 3) has the axes of the link frame."""
    c = np.asarray(com, dtype=float)
    i = np.asarray(inertia_about_com, dtype=float) + mass * _steiner(c)
    return np.array([mass, *(mass * c), i[0, 0], i[0, 1], i[1, 1], i[0, 2], i[1, 2], i[2, 2]])


def body_inertia(parameters: ArrayLike) -> BodyInertia:
    """Return mass, centre of mass and central inertia of ten link parameters (10,)."""
    p = np.asarray(parameters, dtype=float)
    mass = float(p[0])
    com = p[1:4] / mass if mass != 0.0 else np.zeros(3)
    return BodyInertia(mass, com, symmetric(p[4:]) - mass * _steiner(com))


def _steiner(c: Array) -> Array:
    """Return the inertia (3, 3) of a unit mass at c."""
    return np.asarray(c @ c * np.eye(3) - np.outer(c, c))


def impossible_moments(parameters: ArrayLike | None) -> str | None:
    """Return why no body has these moments of inertia about its centre of mass, else None."""
    if parameters is None:
        return None
    moments = np.linalg.eigvalsh(body_inertia(parameters).inertia)
    rounding = 1e-9 * max(abs(moments[-1]), np.abs(np.asarray(parameters)[4:]).max())
    if moments[0] < -rounding:
        return f"the negative principal moment {moments[0]:.3g} kg·m²,"
    if moments[2] > (1.0 + PRINTED) * (moments[0] + moments[1]) + rounding:
        return (
            f"a principal moment of {moments[2]:.3g} kg·m², more than the sum of the two others, "
            f"{moments[0]:.3g} + {moments[1]:.3g},"
        )
    return None


def pseudo_inertia(parameters: ArrayLike) -> Array:
    """Return the pseudo-inertia (4, 4): positive definite iff the body is physically possible.

    Wensing, Kim, Slotine, "Linear matrix inequalities for physically consistent inertial
    parameter identification", IEEE RA-L 2018.
    """
    p = np.asarray(parameters, dtype=float)
    inertia = symmetric(p[4:])
    sigma = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return np.block([[sigma, p[1:4, None]], [p[None, 1:4], p[:1, None]]])


def parameter_transport(pose: Array) -> Array:
    """Return the matrix (10, 10) that expresses link parameters in the parent frame of a pose."""
    moved = pose @ _UNIT_PSEUDO_INERTIAS @ pose.T
    return np.asarray(np.tensordot(_FROM_PSEUDO_INERTIA, moved, axes=((1, 2), (1, 2))))


def _from_pseudo_inertia() -> Array:
    """Return the tensor (10, 4, 4) that maps a pseudo-inertia to link parameters."""
    tensor = np.zeros((10, 4, 4))
    tensor[0, 3, 3] = 1.0
    tensor[[1, 2, 3], [0, 1, 2], 3] = 1.0
    for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), start=4):
        tensor[k, i, j] -= 1.0  # the inertia is trace(Σ)·1 − Σ
        if i == j:
            tensor[k, [0, 1, 2], [0, 1, 2]] += 1.0
    return tensor


_UNIT_PSEUDO_INERTIAS = np.array([pseudo_inertia(unit) for unit in np.eye(10)])
_FROM_PSEUDO_INERTIA = _from_pseudo_inertia()
