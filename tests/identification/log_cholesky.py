"""Reference solution of the problem of `FeasibleProblem`: log-Cholesky parameters, Ipopt.

A pseudo-inertia is U·(margin·1 + T·Tᵀ)·Uᵀ with T upper triangular and a positive diagonal, so that
all ten parameters of T are free. Rucker & Wensing, "Smooth parameterization of rigid-body
inertia", IEEE RA-L 2022. Not convex; independent of the conic solver that it checks.
"""

import casadi as ca
import numpy as np

from lieid_casadi.identification.feasible.problem import MARGIN, FeasibleProblem, linear_constraints
from lieid_casadi.identification.regression.least_squares import Factor

OPTIONS = {
    "print_time": False,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-10,
        "max_iter": 500,
        "bound_relax_factor": 0.0,
    },
}


def solve_log_cholesky(problem: FeasibleProblem, factor: Factor, weight: float) -> np.ndarray:
    """Return the solution (10 n + m,) for the factor of the weighted rows and λ."""
    links, total = 10 * problem.n, problem.combination.shape[1]
    reduced = problem.reduced(factor)
    unknowns = ca.MX.sym("unknowns", total)
    body = _body(MARGIN)
    parts, divergence = [], ca.MX(0)
    for i in range(problem.n):
        numbers, own = body(unknowns[10 * i : 10 * i + 10])
        parts.append(numbers)
        divergence += own
    parameters = ca.DM(problem.scaling) @ ca.vertcat(*parts, unknowns[links:])
    residual = ca.DM(reduced[:, :-1] @ problem.combination) @ parameters - ca.DM(reduced[:, -1])
    rows, bounds = linear_constraints(problem)
    program = {
        "x": unknowns,
        "f": ca.sumsqr(residual) + weight * divergence,
        "g": ca.DM(rows) @ parameters - ca.DM(bounds),
    }
    solver = ca.nlpsol("log_cholesky", "ipopt", program, OPTIONS)
    result = solver(x0=np.zeros(total), lbg=0.0, ubg=np.inf)
    assert solver.stats()["success"], solver.stats()["return_status"]
    to_parameters = ca.Function("parameters", [unknowns], [parameters])
    return problem.within_bounds(to_parameters(result["x"]).full().ravel())


def _body(margin: float) -> ca.Function:
    """Return the function from T (10,) to scaled link parameters of Q and its divergence from 1."""
    x = ca.SX.sym("x", 10)
    t = ca.SX(4, 4)
    for k in range(4):
        t[k, k] = ca.exp(x[k])
    for k, (row, column) in enumerate([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]):
        t[row, column] = x[4 + k]
    q = t @ t.T + margin * ca.SX.eye(4)
    sigma = q[:3, :3]
    inertia = ca.trace(sigma) * ca.SX.eye(3) - sigma
    pairs = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    numbers = ca.vertcat(q[3, 3], q[:3, 3], *(inertia[pair] for pair in pairs))
    root = ca.chol(q)  # for log det: smooth, and accurate near the margin
    logarithm = 2 * sum(ca.log(root[k, k]) for k in range(4))
    return ca.Function("body", [x], [numbers, ca.trace(q) - logarithm - 4])
