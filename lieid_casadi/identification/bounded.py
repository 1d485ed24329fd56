"""Least squares that respects the physics' bounds on linear coefficients (I_a ≥ 0)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from lieid_casadi.identification.least_squares import Factor, Solution, solve
from lieid_casadi.model import Parameter


def solve_bounded(
    factor: Factor, parameters: Sequence[Parameter]
) -> tuple[Solution, NDArray[np.bool_]]:
    """Return the solution within bounds, and a mark on the values (p,) that sit on one.

    A kept link parameter stands for a combination and has no bound of its own.
    """
    lower = np.array([p.lower for p in parameters])
    upper = np.array([p.upper for p in parameters])
    free = solve(factor)
    none = np.zeros(len(parameters), dtype=bool)
    if np.all((free.values >= lower) & (free.values <= upper)):
        return free, none
    r, z = factor.r[:, :-1], factor.r[:, -1]
    scale = np.linalg.norm(r, axis=0)
    scale[scale == 0.0] = 1.0
    result = lsq_linear(r / scale, z, bounds=(lower * scale, upper * scale), method="bvls")
    fixed = np.asarray(result.active_mask != 0)
    values = result.x / scale
    # solve again for the others, so that rank and covariance are treated in one place
    values[fixed] = np.where(result.active_mask[fixed] < 0, lower[fixed], upper[fixed])
    rest = r[:, ~fixed]
    reduced = Factor(np.column_stack([rest, z - r[:, fixed] @ values[fixed]]), factor.rows)
    inner = solve(reduced)
    values[~fixed] = inner.values
    covariance = np.zeros((len(values), len(values)))
    covariance[np.ix_(~fixed, ~fixed)] = inner.unit_covariance
    hidden = []
    for direction in inner.hidden:
        whole = np.zeros(len(values))
        whole[~fixed] = direction
        hidden.append(whole)
    return Solution(values, covariance, tuple(hidden)), fixed
