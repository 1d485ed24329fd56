"""The convex problem of physically possible parameters in CVXPY, solved by Clarabel."""

from __future__ import annotations

import logging
import time
import warnings

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import NoSolution
from lieid_casadi.identification.feasible.problem import PSEUDO, FeasibleProblem
from lieid_casadi.identification.regression.least_squares import Factor

Array = NDArray[np.float64]
log = logging.getLogger("lieid_casadi")
TOLERANCE = 1e-8
FRICTION_MARGIN = 1e-6  # of the joint's noise: friction dissipates in spite of the tolerance

RELAX = (
    "relax the bounds on masses and centres of mass, or give a larger regularization "
    "(option regularization)"
)
STATUS = {
    "infeasible": (
        "no parameters meet all constraints together (the solver has a proof of it); relax the "
        "bounds on masses and centres of mass"
    ),
    "infeasible_inaccurate": f"no parameters seem to meet all constraints together; {RELAX}",
    "unbounded": "the cost has no minimum; give a larger regularization, or data that moves more",
    "unbounded_inaccurate": (
        "the cost seems to have no minimum; give a larger regularization, or data that moves more"
    ),
    "optimal_inaccurate": f"the solver stopped short of its accuracy; {RELAX}",
    "user_limit": (
        "the solver reached its limit of iterations; raise max_iterations, or give a larger "
        "regularization"
    ),
    "solver_error": f"the solver broke down numerically; {RELAX}",
}


class ConvexSolver:
    """One problem, compiled at the first call; then data and λ change at little cost.

    Parameters
    ----------
    problem : FeasibleProblem
    """

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
        hidden = links + np.flatnonzero(~problem.seen)
        if len(hidden):
            constraints.append(self._unknowns[hidden] == 0.0)
        cost = cp.sum_squares(residual) + self._weight * divergence
        self._program = cp.Problem(cp.Minimize(cost), constraints)

    def solve(self, factor: Factor, weight: float) -> Array:
        """Return parameters (10 n + m,).

        Parameters
        ----------
        factor : Factor
            Of the weighted rows.
        weight : float
            λ.

        Raises
        ------
        NoSolution
            The solver did not finish; the message says why and what to try.
        """
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
            raise NoSolution(f"physically possible parameters: {reason}")
        return self.problem.within_bounds(self.problem.scaling @ self._unknowns.value)


def linear_constraints(problem: FeasibleProblem) -> tuple[Array, Array]:
    """Return rows and bounds of row @ parameters ≥ bound, rows of unit size in scaled unknowns."""
    links, total = 10 * problem.n, problem.combination.shape[1]
    rows, bounds = [np.zeros((0, total))], [np.zeros(0)]
    unit = np.eye(total)[links:]
    for side, sign in ((problem.lower, 1.0), (-problem.upper, -1.0)):
        finite = np.isfinite(side) & problem.seen
        rows.append(sign * unit[finite])
        bounds.append(side[finite])
    for row, bound in problem.known_bodies:
        rows.append(np.concatenate([row, np.zeros(total - links)])[None])
        bounds.append(np.array([bound]))
    known, limits = _unit_size(problem, np.vstack(rows), np.concatenate(bounds))
    seen = problem.friction * problem.seen
    friction = np.zeros((len(seen), total))
    friction[:, links:] = seen
    friction = friction[np.any(seen != 0.0, axis=1)]
    friction, zeros = _unit_size(problem, friction, np.zeros(len(friction)))
    return np.vstack([known, friction]), np.concatenate([limits, zeros + FRICTION_MARGIN])


def _unit_size(problem: FeasibleProblem, rows: Array, bounds: Array) -> tuple[Array, Array]:
    size = np.linalg.norm(rows @ problem.scaling, axis=1)
    size[size == 0.0] = 1.0
    return rows / size[:, None], bounds / size
