"""The physically consistent body nearest to an estimate."""

from __future__ import annotations

import numpy as np
from scipy.linalg import null_space

from lieid_casadi.arrays import Array
from lieid_casadi.errors import NoSolution
from lieid_casadi.identification.feasible.convex_solver import ConvexSolver
from lieid_casadi.identification.feasible.problem import FeasibleOptions, FeasibleProblem
from lieid_casadi.identification.regression.least_squares import Factor
from lieid_casadi.robot.inertia import link_parameters, pseudo_inertia

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
        options=FeasibleOptions(),
    )
    solver, failure = ConvexSolver(problem), None
    for relaxation in RELAXATION:
        try:
            return solver.solve(Factor(factor.r / relaxation, factor.rows), WEIGHT)
        except NoSolution as error:
            failure = error
    assert failure is not None
    raise failure


def distance(body: Array, parameters: Array, covariance: Array, hidden: Array) -> float:
    """Return the distance between a body and an estimate in standard deviations.

    ``body``, ``parameters`` (10,): body and estimate: m, m·c, inertia (kg, kg·m, kg·m²);
    ``covariance`` (10, 10): covariance of the estimate; ``hidden`` (h, 10): directions that cannot
    be identified; they do not count.
    """
    return float(np.sqrt(_precision(parameters, covariance, hidden).misfit(body)))


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
