"""The possible body nearest to what was estimated: pseudo-inertia positive definite."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from lieid_casadi.errors import NoSolution
from lieid_casadi.identification.feasible.convex_solver import ConvexSolver
from lieid_casadi.identification.feasible.options import FeasibleOptions
from lieid_casadi.identification.feasible.problem import FeasibleProblem
from lieid_casadi.identification.regression.least_squares import Factor
from lieid_casadi.robot.inertia import link_parameters, pseudo_inertia

Array = NDArray[np.float64]
DENSITY = 2700.0  # kg/m³, aluminium: the ball that stands for a body nothing is known of
ROUNDING = 1e-13  # of the largest variance
LEAST_MASS = 1e-3  # kg, of that ball
WEIGHT = 0.01  # of the divergence from it, against squared standard deviations
SOFTER = (1.0, 10.0, 100.0, 1000.0)  # standard deviations, where the estimate is far from any body
SCALE = np.array([1.0, *(0.1,) * 3, *(0.01,) * 6])  # typical sizes, for rounding only


def possible_body(parameters: Array, covariance: Array, hidden: Array) -> Array:
    """Return ten parameters (10,) of a body that can exist, near an estimate.

    Minimizes the squared distance in standard deviations plus a small divergence (Lee, Wensing,
    Park, T-RO 2020) from a ball, which decides where the data says nothing.

    Parameters
    ----------
    parameters : (10,)
        Estimate.
    covariance : (10, 10)
        Of the estimate, apart from the hidden directions.
    hidden : (h, 10)
        Directions of the parameters that the data does not show.

    Raises
    ------
    NoSolution
        The solver did not finish.
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
    for softer in SOFTER:
        try:
            return solver.solve(Factor(factor.r / softer, factor.rows), WEIGHT)
        except NoSolution as error:
            failure = error
    assert failure is not None
    raise failure


def distance(body: Array, parameters: Array, covariance: Array, hidden: Array) -> float:
    """Return how far a body (10,) is from an estimate, in standard deviations."""
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
    seen = null_space(scaled) if len(scaled) else np.eye(10)
    # what the data tells are the combinations seenᵀ·(parameters / scale)
    values = seen.T @ (parameters / SCALE)
    spread = seen.T @ (covariance / np.outer(SCALE, SCALE)) @ seen
    variance, axes = np.linalg.eigh(spread)
    whiten = (axes / np.sqrt(np.maximum(variance, ROUNDING * variance[-1]))).T
    rows, target = whiten @ (seen.T / SCALE), whiten @ values
    r = np.zeros((11, 11))
    r[: len(rows), :10], r[: len(rows), 10] = rows, target
    return Factor(r, 1)
