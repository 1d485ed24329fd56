"""Total least squares where some columns are noisy (currents) and the others exact.

Per joint j, i_j·k_j − M_j·β − M_j·B·π = 0, the payload's known mass being one column with the
coefficient 1: M. Gautier, S. Briot, "Global identification of joint drive gains and dynamic
parameters of robots", J. Dynamic Systems, Measurement, and Control 2014. Noise is in the currents
alone, and each joint has its own: the exact columns are eliminated first (Golub, Hoffman, Stewart,
Linear Algebra and its Applications 1987), rows are weighted by 1/(k_j·σ_j), and both are repeated
until the gains settle. The fixed point is the maximum of the likelihood over gains, parameters
and the joints' noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification.least_squares import Factor

Array = NDArray[np.float64]
RANK = 1e-9  # of scaled columns
SHOWN = 1e-6  # of the known column's norm that the others leave


@dataclass(frozen=True, eq=False)
class NullVector:
    """The null vector [gains; others; 1] of the rows.

    Attributes
    ----------
    gains : (n,)
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
    noisy, exact = r[:, :n] / noise, r[:, n:]
    size = np.linalg.norm(exact, axis=0)
    exact = exact / np.where(size > 0.0, size, 1.0)
    if size[-1] == 0.0 or _own_part(exact) < SHOWN:
        return None
    u, singular, _ = np.linalg.svd(exact, full_matrices=False)
    basis = u[:, singular > RANK * singular[0]]
    _, _, vt = np.linalg.svd(noisy - basis @ (basis.T @ noisy))
    direction = vt[-1]
    coefficients = np.linalg.lstsq(exact, -noisy @ direction, rcond=RANK)[0]
    coefficients = coefficients / np.where(size > 0.0, size, 1.0)
    if coefficients[-1] == 0.0:
        return None
    gains = direction / noise / coefficients[-1]
    return NullVector(gains, coefficients[:-1] / coefficients[-1])


def _own_part(exact: Array) -> float:
    """Return what the other columns leave of the last one, of unit size."""
    others, last = exact[:, :-1], exact[:, -1]
    fitted = others @ np.linalg.lstsq(others, last, rcond=RANK)[0]
    return float(np.linalg.norm(last - fitted))
