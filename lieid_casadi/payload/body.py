"""From a payload's ten parameters to mass, centre of mass and central inertia, with covariance.

The parameters are m, m·c (3), Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the tool frame's origin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.robot.inertia import body_inertia

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NAMES = ("mass", "com_x", "com_y", "com_z", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
UNITS = ("kg", "m", "m", "m", *("kg·m²",) * 6)
_ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def physical(parameters: Array) -> Array:
    """Return mass, centre of mass (3) and inertia about it (6) as one array (10,)."""
    body = body_inertia(parameters)
    return np.array([body.mass, *body.com, *(body.inertia[i, j] for i, j in _ENTRIES)])


def physical_slopes(parameters: Array) -> Array:
    """Return the derivatives (10, 10) of `physical` by the parameters; mass not zero."""
    m, moment = float(parameters[0]), parameters[1:4]
    slopes = np.zeros((10, 10))
    slopes[0, 0] = 1.0
    slopes[1:4, 0] = -moment / m**2
    slopes[1:4, 1:4] = np.eye(3) / m
    square = moment @ moment * np.eye(3) - np.outer(moment, moment)
    for row, (i, j) in enumerate(_ENTRIES, start=4):
        slopes[row, row] = 1.0
        slopes[row, 0] = square[i, j] / m**2
        for k in range(3):
            # of |mc|²·1 − mc·mcᵀ
            change = 2.0 * moment[k] * (i == j) - (i == k) * moment[j] - (j == k) * moment[i]
            slopes[row, 1 + k] = -change / m
    return slopes


def _depends_on() -> Mask:
    """Mark which parameters (columns) each quantity of `physical` (rows) is made of."""
    depends = np.eye(10, dtype=bool)
    depends[1:, 0] = True
    for row, (i, j) in enumerate(_ENTRIES, start=4):
        moments = {i, j} if i != j else {0, 1, 2} - {i}
        depends[row, [1 + k for k in moments]] = True
    return depends


DEPENDS_ON = _depends_on()


def told(hidden: Array) -> Mask:
    """Mark the quantities of `physical` that the data tells at all.

    Parameters
    ----------
    hidden : (h, 10)
        Directions of the parameters that leave every torque as it is, in comparable units.
    """
    unseen = np.abs(hidden).max(axis=0, initial=0.0) > 1e-6
    return np.asarray(~np.any(DEPENDS_ON & unseen, axis=1))
