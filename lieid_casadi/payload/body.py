"""Mass, centre of mass and central inertia of a payload; the nearest physically consistent body.

The parameters are m, m·c (3), Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin of the tool frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from lieid_casadi.arrays import Array
from lieid_casadi.errors import NoSolution
from lieid_casadi.identification.feasible.problem import (
    ConvexSolver,
    FeasibleProblem,
)
from lieid_casadi.identification.regression.least_squares import Factor
from lieid_casadi.robot.inertia import body_inertia, link_parameters, pseudo_inertia

Mask = NDArray[np.bool_]

NAMES = ("mass", "com_x", "com_y", "com_z", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
UNITS = ("kg", "m", "m", "m", *("kg·m²",) * 6)
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


def body_dict(parameters: Array) -> dict[str, Any]:
    """Return mass, centre of mass, central inertia and pseudo-inertia eigenvalues for JSON."""
    values = physical_quantities(parameters)
    return {
        "mass": float(values[0]),
        "com": values[1:4].tolist(),
        "inertia": values[4:].tolist(),
        "eigenvalues": np.linalg.eigvalsh(pseudo_inertia(parameters)).tolist(),
    }


DENSITY = 2700.0  # kg/m³, aluminium: density of the reference ball
ROUNDING = 1e-13  # least variance relative to the largest
LEAST_MASS = 1e-3  # kg, least mass of the reference ball
WEIGHT = 0.01  # of the divergence from the ball relative to squared standard deviations
RELAXATION = (1.0, 10.0, 100.0, 1000.0)  # factors on the standard deviations, tried in this order
SCALE = np.array([1.0, *(0.1,) * 3, *(0.01,) * 6])  # typical sizes of parameters, for scaling


def nearest_feasible_body(parameters: Array, covariance: Array, hidden: Array) -> Array:
    """Return the parameters (10,) of the physically consistent body nearest to an estimate.

    Its pseudo-inertia is positive definite. The objective is the squared distance in standard
    deviations plus a small entropic divergence (Lee, Wensing, Park, T-RO 2020) from a ball of the
    estimated mass, which determines the directions that the data does not show. Where the
    estimate is so far from any feasible body that the solver fails, the standard deviations are
    enlarged.

    ``parameters`` (10,): estimate: m, m·c, inertia about the tool frame's origin (kg, kg·m, kg·m²);
    ``covariance`` (10, 10): covariance of the estimate, zero along the hidden directions;
    ``hidden`` (h, 10): directions of the parameters that cannot be identified from the data.
    Raises `NoSolution`: the solver fails for every relaxation.
    """
    factor = _precision(parameters, covariance, hidden)
    problem = FeasibleProblem(
        combination=np.eye(10),
        references=pseudo_inertia(_ball(parameters))[None],
        lower=np.zeros(0),
        upper=np.zeros(0),
        friction=np.zeros((0, 0)),
        typical=factor,
    )
    solver, failure = ConvexSolver(problem), None
    for relaxation in RELAXATION:
        try:
            return solver.solve(Factor(factor.r / relaxation, factor.rows), WEIGHT)
        except NoSolution as error:
            failure = error
    assert failure is not None
    raise failure


def _ball(parameters: Array) -> Array:
    """Return a ball of the estimated mass at the estimated centre."""
    mass = max(float(parameters[0]), LEAST_MASS)
    centre = parameters[1:4] / mass if parameters[0] > LEAST_MASS else np.zeros(3)
    radius = (3.0 * mass / (4.0 * np.pi * DENSITY)) ** (1.0 / 3.0)
    return link_parameters(mass, centre, 0.4 * mass * radius**2 * np.eye(3))


def _precision(parameters: Array, covariance: Array, hidden: Array) -> Factor:
    """Return rows whose squares sum to the squared distance in standard deviations."""
    scaled = hidden / SCALE
    visible = null_space(scaled) if len(scaled) else np.eye(10)
    # the data determines the combinations visibleᵀ·(parameters / scale)
    values = visible.T @ (parameters / SCALE)
    spread = visible.T @ (covariance / np.outer(SCALE, SCALE)) @ visible
    variance, axes = np.linalg.eigh(spread)
    whiten = (axes / np.sqrt(np.maximum(variance, ROUNDING * variance[-1]))).T
    rows, target = whiten @ (visible.T / SCALE), whiten @ values
    r = np.zeros((11, 11))
    r[: len(rows), :10], r[: len(rows), 10] = rows, target
    return Factor(r, 1)
