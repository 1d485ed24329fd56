"""Total least squares where some columns are noisy (currents) and the others exact.

Per joint j, i_j·k_j − M_j·β − M_j·B·π = 0, the payload's known mass being one column with the
coefficient 1: M. Gautier, S. Briot, "Global identification of joint drive gains and dynamic
parameters of robots", J. Dynamic Systems, Measurement, and Control 2014. Noise is in the currents
alone, and each joint has its own. The exact columns are eliminated first (Golub, Hoffman, Stewart,
Linear Algebra and its Applications 1987); from that null vector, which weighs all joints' rows
alike, the maximum of the likelihood is found, where the error of each current counts in units of
its own noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from lieid_casadi.identification.regression.least_squares import Factor

Array = NDArray[np.float64]
RANK = 1e-9  # of scaled columns
SHOWN = 1e-6  # of the known column's norm that the others leave
MOST_STEPS = 50  # of the search


@dataclass(frozen=True, eq=False)
class NullVector:
    """The null vector [gains; others; 1] of the rows.

    Attributes
    ----------
    gains : (n,)
        Zero where the column is zero: a joint that never moves.
    others : (q,)
        Coefficients of the exact columns but the last.
    """

    gains: Array
    others: Array


def null_vector(factor: Factor, noise: Array) -> NullVector | None:
    """Return the null vector, or None where the last column shows nothing of its own.

    Parameters
    ----------
    factor : Factor
        Of the weighted rows; columns: n noisy ones, q exact ones, the known one.
    noise : (n,)
        Of each noisy column: expected norm of the noise in its weighted rows.
    """
    n, r = len(noise), factor.r
    there = np.linalg.norm(r[:, :n], axis=0) > 0.0
    noisy, exact = r[:, :n][:, there] / noise[there], r[:, n:]
    size = np.linalg.norm(exact, axis=0)
    exact = exact / np.where(size > 0.0, size, 1.0)
    if size[-1] == 0.0 or not there.any() or _own_part(exact) < SHOWN:
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
    gains[there] = direction / noise[there] / coefficients[-1]
    return NullVector(gains, coefficients[:-1] / coefficients[-1])


def most_likely(factors: Sequence[Factor], start: NullVector, noise: Array) -> NullVector:
    """Return gains and others that minimize Σ_j ‖i_j − torque_j/k_j‖² / σ_j².

    The unknowns are 1/k_j, in which a gain that the motion hardly tells does no harm.

    Parameters
    ----------
    factors : sequence of n Factor
        Of each joint's rows, columns as for `null_vector`.
    start : NullVector
        Near the minimum.
    noise : (n,)
        σ_j of the currents, A.
    """
    n = len(noise)
    there = [int(j) for j in np.flatnonzero(start.gains)]
    current = [factors[j].r[:, j] / noise[j] for j in there]
    torque = [-factors[j].r[:, n:] / noise[j] for j in there]

    def error(x: Array) -> Array:
        others = np.append(x[len(there) :], 1.0)
        return np.concatenate(
            [i - a * (m @ others) for i, a, m in zip(current, x, torque, strict=False)]
        )

    def slopes(x: Array) -> Array:
        others = np.append(x[len(there) :], 1.0)
        blocks = []
        for k, (a, m) in enumerate(zip(x, torque, strict=False)):
            block = np.zeros((len(m), len(x)))
            block[:, k], block[:, len(there) :] = -m @ others, -a * m[:, :-1]
            blocks.append(block)
        return np.vstack(blocks)

    first = np.concatenate([1.0 / start.gains[there], start.others])
    x = least_squares(
        error, first, slopes, x_scale="jac", max_nfev=MOST_STEPS, ftol=1e-12, xtol=1e-12, gtol=1e-12
    ).x
    gains = np.zeros(n)
    gains[there] = 1.0 / x[: len(there)]
    return NullVector(gains, x[len(there) :])


def _own_part(exact: Array) -> float:
    """Return what the other columns leave of the last one, of unit size."""
    others, last = exact[:, :-1], exact[:, -1]
    fitted = others @ np.linalg.lstsq(others, last, rcond=RANK)[0]
    return float(np.linalg.norm(last - fitted))
