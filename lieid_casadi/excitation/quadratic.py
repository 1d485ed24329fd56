"""Small dense quadratic programs, by the active-set solver that comes with CasADi (qpOASES)."""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROWS = 64  # a solver serves all programs with up to a multiple of so many rows


@dataclass(frozen=True, eq=False)
class Step:
    """The solution d (m,), multipliers (rows,) ≥ 0, and whether the solver found it."""

    step: Array
    multipliers: Array
    solved: bool


class QuadraticPrograms:
    """min ½dᵀHd + gᵀd subject to A·d ≤ b, |d| ≤ bound, for one number of variables m."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._solvers: dict[int, ca.Function] = {}

    def solve(
        self, hessian: Array, gradient: Array, matrix: Array, limit: Array, bound: Array
    ) -> Step:
        """Solve one program.

        Parameters
        ----------
        hessian : (m, m)
            Positive definite.
        gradient : (m,)
        matrix, limit : (rows, m), (rows,)
        bound : (m, 2)
            Lower and upper bounds of d.
        """
        count = len(limit)
        solver = self._solver(count)
        padded = np.zeros((solver.size1_in("a"), self.size))
        padded[:count] = matrix
        upper = np.full(len(padded), np.inf)
        upper[:count] = limit
        result = solver(
            h=hessian, g=gradient, a=padded, uba=upper, lbx=bound[:, 0], ubx=bound[:, 1]
        )
        return Step(
            result["x"].full().ravel(),
            np.maximum(result["lam_a"].full().ravel()[:count], 0.0),
            bool(solver.stats()["success"]),
        )

    def _solver(self, rows: int) -> ca.Function:
        capacity = ROWS * max(1, -(-rows // ROWS))
        if capacity not in self._solvers:
            shapes = {
                "h": ca.Sparsity.dense(self.size, self.size),
                "a": ca.Sparsity.dense(capacity, self.size),
            }
            options: dict[str, Any] = {
                "printLevel": "none",
                "sparse": False,
                "print_time": False,
                "error_on_fail": False,
            }
            with contextlib.redirect_stdout(io.StringIO()):  # the solver announces itself
                self._solvers[capacity] = ca.conic("qp", "qpoases", shapes, options)
        return self._solvers[capacity]
