"""The same problem without constraints on bodies: log-Cholesky parameters, Ipopt, CasADi.

A pseudo-inertia is U·(margin·1 + T·Tᵀ)·Uᵀ with T upper triangular, its diagonal exponentials:
every value of the ten numbers of T is a body that can exist. Rucker & Wensing, "Smooth
parameterization of rigid-body inertia", IEEE RA-L 2022. Not convex, but free to take nonlinear
additions, and independent of the conic solver that it checks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import NoSolution
from lieid_casadi.identification.feasible.convex_solver import linear_constraints
from lieid_casadi.identification.feasible.problem import FeasibleProblem
from lieid_casadi.identification.regression.least_squares import Factor

Array = NDArray[np.float64]
Addition = Callable[[ca.MX], ca.MX]
TOLERANCE = 1e-10
MAX_ITERATIONS = 500


def solve_log_cholesky(
    problem: FeasibleProblem,
    factor: Factor,
    weight: float,
    *,
    further_cost: Addition | None = None,
    further_constraints: Addition | None = None,
    start: Array | None = None,
) -> Array:
    """Return parameters (10 n + m,) that solve the problem of `FeasibleProblem` in Ipopt.

    Parameters
    ----------
    factor : Factor
        Of the weighted rows.
    weight : float
        λ.
    further_cost : callable, optional
        Parameters (10 n + m, 1) to a scalar that is added to the cost; any smooth function.
    further_constraints : callable, optional
        Parameters to a column that must not be negative.
    start : (10 n + m,), optional
        Coefficients to start from; bodies start at their references.

    Raises
    ------
    NoSolution
        Ipopt did not converge.
    """
    links, total = 10 * problem.n, problem.combination.shape[1]
    reduced = problem.reduced(factor)
    unknowns = ca.MX.sym("unknowns", total)
    body = _body(problem.options.margin)
    parts, divergence = [], ca.MX(0)
    for i in range(problem.n):
        numbers, own = body(unknowns[10 * i : 10 * i + 10])
        parts.append(numbers)
        divergence += own
    parameters = ca.DM(problem.scaling) @ ca.vertcat(*parts, unknowns[links:])
    residual = ca.DM(reduced[:, :-1] @ problem.combination) @ parameters - ca.DM(reduced[:, -1])
    cost = ca.sumsqr(residual) + weight * divergence
    rows, bounds = linear_constraints(problem)
    constraints = [ca.DM(rows) @ parameters - ca.DM(bounds)]
    if further_cost is not None:
        cost += further_cost(parameters)
    if further_constraints is not None:
        constraints.append(further_constraints(parameters))
    result, solver = _run(unknowns, cost, ca.vertcat(*constraints), _start(problem, start))
    if not solver.stats()["success"]:
        status = str(solver.stats()["return_status"]).replace("_", " ").lower()
        raise NoSolution(
            f"physically possible parameters by Ipopt: {status}; give a larger regularization, "
            "leave out a bound, or start nearer to the solution"
        )
    to_parameters = ca.Function("parameters", [unknowns], [parameters])
    return problem.within_bounds(to_parameters(result["x"]).full().ravel())


def _run(unknowns: ca.MX, cost: ca.MX, constraints: ca.MX, start: Array) -> tuple[Any, ca.Function]:
    options: dict[str, Any] = {
        "print_time": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "tol": TOLERANCE,
            "max_iter": MAX_ITERATIONS,
            "bound_relax_factor": 0.0,
        },
    }
    program: dict[str, Any] = {"x": unknowns, "f": cost, "g": constraints}
    solver = ca.nlpsol("log_cholesky", "ipopt", program, options)
    return solver(x0=start, lbg=0.0, ubg=np.inf), solver


def _start(problem: FeasibleProblem, coefficients: Array | None) -> Array:
    """Return the unknowns at the reference bodies, strictly inside the margin."""
    links, total = 10 * problem.n, problem.combination.shape[1]
    start = np.zeros(total)
    if coefficients is not None:
        scale = np.diag(problem.scaling)[links:]
        start[links:] = coefficients[links:] / scale
    return start


def _body(margin: float) -> ca.Function:
    """Return ten numbers of T ↦ scaled link parameters of Q, and the divergence of Q from 1."""
    x = ca.SX.sym("x", 10)
    t = ca.SX(4, 4)
    for k in range(4):
        t[k, k] = ca.exp(x[k])
    for k, (row, column) in enumerate([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]):
        t[row, column] = x[4 + k]
    q = t @ t.T + margin * ca.SX.eye(4)
    sigma = q[:3, :3]
    inertia = ca.trace(sigma) * ca.SX.eye(3) - sigma
    numbers = ca.vertcat(
        q[3, 3],
        q[:3, 3],
        inertia[0, 0],
        inertia[0, 1],
        inertia[1, 1],
        inertia[0, 2],
        inertia[1, 2],
        inertia[2, 2],
    )
    # log det by a Cholesky factor: smooth, and exact near the margin
    root = ca.chol(q)
    logarithm = 2 * sum(ca.log(root[k, k]) for k in range(4))
    return ca.Function("body", [x], [numbers, ca.trace(q) - logarithm - 4])
