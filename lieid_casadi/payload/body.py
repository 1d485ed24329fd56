"""Mass, centre of mass and central inertia of a payload.

The parameters are m, m·c (3), Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin of the tool frame.
"""

from __future__ import annotations

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.robot.inertia import body_inertia

NAMES = ("mass", "com_x", "com_y", "com_z", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
UNITS = ("kg", "m", "m", "m", *("kg·m²",) * 6)
SCALE = np.array([1.0, *(0.1,) * 3, *(0.01,) * 6])  # typical sizes of parameters, for scaling
_ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def physical_quantities(parameters: Array) -> Array:
    """Return mass, centre of mass (3) and inertia about it (6) as one array (10,)."""
    body = body_inertia(parameters)
    return np.array([body.mass, *body.com, *(body.inertia[i, j] for i, j in _ENTRIES)])


def physical_jacobian(parameters: Array) -> Array:
    """Return the Jacobian (10, 10) of `physical_quantities` at parameters with non-zero mass."""
    m, moment = float(parameters[0]), parameters[1:4]
    jacobian = np.zeros((10, 10))
    jacobian[0, 0] = 1.0
    jacobian[1:4, 0] = -moment / m**2
    jacobian[1:4, 1:4] = np.eye(3) / m
    square = moment @ moment * np.eye(3) - np.outer(moment, moment)
    for row, (i, j) in enumerate(_ENTRIES, start=4):
        jacobian[row, row] = 1.0
        jacobian[row, 0] = square[i, j] / m**2
        for k in range(3):
            # derivative of |mc|²·1 − mc·mcᵀ
            change = 2.0 * moment[k] * (i == j) - (i == k) * moment[j] - (j == k) * moment[i]
            jacobian[row, 1 + k] = -change / m
    return jacobian


#: Parameters (columns) that each physical quantity (rows) depends on: those of a general body
DEPENDS_ON: Mask = physical_jacobian(np.arange(1.0, 11.0)) != 0.0


def identifiable_quantities(hidden: Array) -> Mask:
    """Mark the physical quantities (10,) that can be identified from the data."""
    hidden_parameters = np.abs(hidden).max(axis=0, initial=0.0) > 1e-6
    return np.asarray(~np.any(DEPENDS_ON & hidden_parameters, axis=1))
