"""Small dense quadratic programs by the non-negative least squares of Lawson and Hanson.

min ½dᵀHd + gᵀd with A·d ≤ b becomes, in x = Lᵀd + L⁻¹g with H = LLᵀ, the least-distance problem
min ‖x‖ with G·x ≥ h, and that the non-negative least squares problem of its multipliers (Lawson,
Hanson, "Solving least squares problems", 1974, chapter 23). Its size is that of the rows, about
fifty in an iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
INCOMPATIBLE = 1e-14  # smallest squared distance of the multipliers' problem with a solution


@dataclass(frozen=True, eq=False)
class QuadraticSolution:
    """The solution d (m,) and its multipliers (rows,) ≥ 0."""

    step: Array
    multipliers: Array


def solve(hessian: Array, gradient: Array, matrix: Array, limit: Array) -> QuadraticSolution | None:
    """Return the solution of min ½dᵀHd + gᵀd with A·d ≤ b.

    Parameters
    ----------
    hessian : (m, m)
        H, positive definite.
    gradient : (m,)
        g.
    matrix : (rows, m)
        A.
    limit : (rows,)
        b.

    Returns
    -------
    QuadraticSolution or None
        None if the rows are incompatible, or if H is not positive definite to rounding.
    """
    from scipy.linalg import cho_factor, solve_triangular
    from scipy.optimize import nnls

    try:
        factor, _ = cho_factor(hessian, lower=True)
    except np.linalg.LinAlgError:
        return None
    free = solve_triangular(factor, gradient, lower=True)
    if not len(limit):
        return QuadraticSolution(-solve_triangular(factor, free, lower=True, trans=1), np.zeros(0))
    across = -solve_triangular(factor, matrix.T, lower=True)
    least = free @ across - limit
    target = np.zeros(len(free) + 1)
    target[-1] = 1.0
    system = np.vstack([across, least])
    try:
        weights, _ = nnls(system, target)
    except RuntimeError:  # no convergence
        return None
    residual = system @ weights - target
    if -residual[-1] < INCOMPATIBLE:
        return None
    distance = residual[:-1] / -residual[-1]
    step = solve_triangular(factor, distance - free, lower=True, trans=1)
    return QuadraticSolution(step, weights / -residual[-1])
