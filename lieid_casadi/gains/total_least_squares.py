"""Total least squares with noisy columns (currents) and exact columns.

The equation of joint j is i_j·k_j − M_j·β − M_j·B·π = 0, in which the known mass of the payload is
one column with coefficient 1: M. Gautier, S. Briot, "Global identification of joint drive gains and
dynamic parameters of robots", J. Dynamic Systems, Measurement, and Control 2014. Only the currents
are noisy, each with its own noise level. `null_vector` eliminates the exact columns first (Golub,
Hoffman, Stewart, Linear Algebra and its Applications 1987) and weights the rows of all joints
equally. `most_likely` starts from its result and maximizes the likelihood, which weights the error
of each current with that current's noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from lieid_casadi.arrays import Array
from lieid_casadi.identification.regression.least_squares import Factor

RANK = 1e-9  # relative tolerance on singular values of scaled columns
INDEPENDENT = 1e-6  # least part of the known column that the other columns may not explain
MOST_EVALUATIONS = 50  # of the nonlinear least-squares search


@dataclass(frozen=True, eq=False)
class NullVector:
    """The null vector [gains; others; 1] of the stacked rows.

    Attributes
    ----------
    gains : (n,)
        N·m/A; zero for a zero column, that is for a joint that never moves.
    others : (q − 1,)
        Coefficients of the exact columns without the last column, whose coefficient is 1.
    """

    gains: Array
    others: Array


def null_vector(factor: Factor, noise: Array) -> NullVector | None:
    """Return the null vector, or None if the other columns explain the last column.

    ``factor``: triangular factor of the weighted rows: n noisy columns, then q exact columns, the
    last of which has coefficient 1; ``noise`` (n,): expected norm of the noise in the weighted rows
    of each noisy column.

    Notes
    -----
    Golub, Hoffman, Stewart, "A generalization of the Eckart-Young-Mirsky matrix approximation
    theorem", Linear Algebra and its Applications 1987.
    """
    n, r = len(noise), factor.r
    moves = np.linalg.norm(r[:, :n], axis=0) > 0.0
    noisy, exact = r[:, :n][:, moves] / noise[moves], r[:, n:]
    size = np.linalg.norm(exact, axis=0)
    exact = exact / np.where(size > 0.0, size, 1.0)
    if size[-1] == 0.0 or not moves.any() or _own_part(exact) < INDEPENDENT:
        return None
    u, singular, _ = np.linalg.svd(exact, full_matrices=False)
    basis = u[:, singular > RANK * singular[0]]
    _, _, vt = np.linalg.svd(noisy - basis @ (basis.T @ noisy))
    direction = vt[-1]
    coefficients = np.linalg.lstsq(exact, -noisy @ direction, rcond=RANK)[0]
    coefficients = coefficients / np.where(size > 0.0, size, 1.0)
    if coefficients[-1] == 0.0:
        return None
    gains = np.zeros(n)
    gains[moves] = direction / noise[moves] / coefficients[-1]
    return NullVector(gains, coefficients[:-1] / coefficients[-1])


def most_likely(factors: Sequence[Factor], start: NullVector, noise: Array) -> NullVector:
    """Return gains and others that minimize Σ_j ‖i_j − torque_j/k_j‖² / σ_j².

    The unknowns are 1/k_j, so that a gain with a large uncertainty does not disturb the others.

    ``factors``: triangular factors of each joint's rows, with the columns of `null_vector`;
    ``start``: a point near the minimum; ``noise`` (n,): standard deviations σ_j of the currents'
    noise, A.
    """
    n = len(noise)
    moving = [int(j) for j in np.flatnonzero(start.gains)]
    current = [factors[j].r[:, j] / noise[j] for j in moving]
    torque = [-factors[j].r[:, n:] / noise[j] for j in moving]

    def error(x: Array) -> Array:
        others = np.append(x[len(moving) :], 1.0)
        return np.concatenate(
            [i - a * (m @ others) for i, a, m in zip(current, x, torque, strict=False)]
        )

    def slopes(x: Array) -> Array:
        others = np.append(x[len(moving) :], 1.0)
        blocks = []
        for k, (a, m) in enumerate(zip(x, torque, strict=False)):
            block = np.zeros((len(m), len(x)))
            block[:, k], block[:, len(moving) :] = -m @ others, -a * m[:, :-1]
            blocks.append(block)
        return np.vstack(blocks)

    first = np.concatenate([1.0 / start.gains[moving], start.others])
    x = least_squares(
        error,
        first,
        slopes,
        x_scale="jac",
        max_nfev=MOST_EVALUATIONS,
        ftol=1e-12,
        xtol=1e-12,
        gtol=1e-12,
    ).x
    gains = np.zeros(n)
    gains[moving] = 1.0 / x[: len(moving)]
    return NullVector(gains, x[len(moving) :])


def _own_part(exact: Array) -> float:
    """Return the norm of the last column's part that the other columns do not explain."""
    others, last = exact[:, :-1], exact[:, -1]
    fitted = others @ np.linalg.lstsq(others, last, rcond=RANK)[0]
    return float(np.linalg.norm(last - fitted))
