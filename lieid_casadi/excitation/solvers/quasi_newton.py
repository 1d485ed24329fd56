"""A dense Hessian from gradients alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TINY = 1e-14  # squared move, from which rounding would shape the Hessian


def first_hessian(gradient: Array) -> Array:
    """Return the Hessian (m, m) to begin with: a unit step where the gradient is one."""
    return np.eye(len(gradient)) * max(1e-3, float(np.linalg.norm(gradient)))


def damped_bfgs(hessian: Array, move: Array, change: Array) -> Array:
    """Return the updated Hessian, positive definite (Powell's damping).

    ``change`` (m,) is that of the Lagrangian's gradient along ``move`` (m,).
    """
    turned = hessian @ move
    curvature = float(move @ turned)
    if curvature <= TINY * float(np.trace(hessian)):
        return hessian
    along = float(move @ change)
    share = 1.0 if along >= 0.2 * curvature else 0.8 * curvature / (curvature - along)
    target = share * change + (1.0 - share) * turned
    updated = hessian - np.outer(turned, turned) / curvature
    return np.asarray(updated + np.outer(target, target) / float(move @ target))
