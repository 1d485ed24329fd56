"""Force on the tool that explains a transient error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.events.residual_signals import ResidualSignals
from lieid_casadi.identification import Fit

Array = NDArray[np.float64]
CONSISTENT = 0.9  # of the squared error that a force must explain
DIMENSIONS = 3  # of a force: with as many joints or fewer, any error is consistent with one
LEAST_SINGULAR = 0.05  # relative; forces along weaker directions are not determined


def tool_force(
    fit: Fit, own: ResidualSignals, scale: Array, rows: slice
) -> tuple[float, float, float] | None:
    """Return the force on the tool (3,), base axes, N, at the peak of an error; None if none is.

    The drives balance a force f on the tool by the torque −Jᵀ f, less what dry friction of the
    joints that are held balances.

    Parameters
    ----------
    fit : Fit
    own : ResidualSignals
    scale : (n,)
        Standard deviation of each joint's error, N·m.
    rows : slice
        Of the error.
    """
    if fit.model.n <= DIMENSIONS:
        return None
    size = np.max(own.excess[rows] / scale, axis=1)
    at = rows.start + int(np.argmax(size))
    q = own.segment.q[own.segment.kept][at]
    jacobian = fit.compiled.jacobian(q[None])[0, 3:]
    weight = 1.0 / np.hypot(scale, own.held[at])
    matrix, target = -(jacobian * weight).T, own.transient[at] * weight
    force = np.linalg.lstsq(matrix, target, rcond=LEAST_SINGULAR)[0]
    rest = np.abs(target - matrix @ force) - own.held[at] * weight
    if np.sum(np.maximum(rest, 0.0) ** 2) > (1.0 - CONSISTENT) * np.sum(target**2):
        return None
    x, y, z = map(float, force)
    return x, y, z
