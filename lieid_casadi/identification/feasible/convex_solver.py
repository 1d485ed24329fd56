"""Solver of the convex problem of physically consistent parameters: CVXPY with Clarabel."""

from __future__ import annotations

import logging
import time
import warnings

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import NoSolution
from lieid_casadi.identification.feasible.problem import PSEUDO, FeasibleProblem
from lieid_casadi.identification.regression.least_squares import Factor

log = logging.getLogger("lieid_casadi")
TOLERANCE = 1e-8
FRICTION_MARGIN = 1e-6  # of the joint's noise: keeps friction dissipative within the tolerance

RELAX = (
    "relax the bounds on masses and centres of mass, or give a larger regularization "
    "(option regularization)"
)
STATUS = {
    "infeasible": (
        "no parameters satisfy all constraints (proved by the solver); relax the bounds on masses "
        "and centres of mass"
    ),
    "infeasible_inaccurate": f"probably no parameters satisfy all constraints; {RELAX}",
    "unbounded": "the cost has no minimum; give a larger regularization, or record more excitation",
    "unbounded_inaccurate": (
        "the cost has probably no minimum; give a larger regularization, or record more excitation"
    ),
    "optimal_inaccurate": f"the solver did not reach its accuracy; {RELAX}",
    "user_limit": (
        "the solver reached its limit of iterations; raise max_iterations, or give a larger "
        "regularization"
    ),
    "solver_error": f"the solver failed numerically; {RELAX}",
}


class ConvexSolver:
    """Solver of one problem; compiled at the first call, reused for other data and other λ."""

    def __init__(self, problem: FeasibleProblem) -> None:
        import cvxpy as cp

        self.problem = problem
        p, total = problem.combination.shape
        links = 10 * problem.n
        self._unknowns = cp.Variable(total)
        self._matrix = cp.Parameter((p + 1, p))
        self._target = cp.Parameter(p + 1)
        self._weight = cp.Parameter(nonneg=True)
        to_base = problem.combination @ problem.scaling
        residual = self._matrix @ (to_base @ self._unknowns) - self._target
        unit = np.eye(4)
        divergence, constraints = 0.0, []
        for i in range(problem.n):
            body = cp.reshape(PSEUDO @ self._unknowns[10 * i : 10 * i + 10], (4, 4), order="C")
            divergence += cp.trace(body) - cp.log_det(body)
            constraints.append(body >> problem.options.margin * unit)
        rows, bounds = linear_constraints(problem)
        if len(rows):
            constraints.append((rows @ problem.scaling) @ self._unknowns >= bounds)
        inactive = links + np.flatnonzero(~problem.active)
        if len(inactive):
            constraints.append(self._unknowns[inactive] == 0.0)
        cost = cp.sum_squares(residual) + self._weight * divergence
        self._program = cp.Problem(cp.Minimize(cost), constraints)

    def solve(self, factor: Factor, weight: float) -> Array:
        """Return parameters (10 n + m,)."""
        import cvxpy as cp

        reduced = self.problem.reduced(factor)
        self._matrix.value, self._target.value = reduced[:, :-1], reduced[:, -1]
        self._weight.value = weight
        began = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate solution is refused below
            try:
                self._program.solve(
                    solver=cp.CLARABEL,
                    max_iter=self.problem.options.max_iterations,
                    tol_gap_abs=TOLERANCE,
                    tol_gap_rel=TOLERANCE,
                    tol_feas=TOLERANCE,
                )
                status = str(self._program.status)
            except cp.SolverError:
                status = "solver_error"
        log.debug("feasible: λ %.3g, %s in %.3f s", weight, status, time.perf_counter() - began)
        if status != cp.OPTIMAL or self._unknowns.value is None:
            reason = STATUS.get(status, f"the solver stopped with status {status}; {RELAX}")
            raise NoSolution(f"physically consistent parameters: {reason}")
        return self.problem.within_bounds(self.problem.scaling @ self._unknowns.value)


def linear_constraints(problem: FeasibleProblem) -> tuple[Array, Array]:
    """Return rows (K, 10 n + m) and bounds (K,) of the constraints row @ parameters ≥ bound.

    Rows have unit norm in scaled unknowns.
    """
    links, total = 10 * problem.n, problem.combination.shape[1]
    rows, bounds = [np.zeros((0, total))], [np.zeros(0)]
    unit = np.eye(total)[links:]
    for side, sign in ((problem.lower, 1.0), (-problem.upper, -1.0)):
        finite = np.isfinite(side) & problem.active
        rows.append(sign * unit[finite])
        bounds.append(side[finite])
    for row, bound in problem.body_bounds:
        rows.append(np.concatenate([row, np.zeros(total - links)])[None])
        bounds.append(np.array([bound]))
    bodies, limits = _unit_norm(problem, np.vstack(rows), np.concatenate(bounds))
    active = problem.friction * problem.active
    friction = np.zeros((len(active), total))
    friction[:, links:] = active
    friction = friction[np.any(active != 0.0, axis=1)]
    friction, zeros = _unit_norm(problem, friction, np.zeros(len(friction)))
    return np.vstack([bodies, friction]), np.concatenate([limits, zeros + FRICTION_MARGIN])


def _unit_norm(problem: FeasibleProblem, rows: Array, bounds: Array) -> tuple[Array, Array]:
    size = np.linalg.norm(rows @ problem.scaling, axis=1)
    size[size == 0.0] = 1.0
    return rows / size[:, None], bounds / size
