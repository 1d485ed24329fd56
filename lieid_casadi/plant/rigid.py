"""Torques of the plant's rigid arm by Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.robot.pinocchio_model import TOOL_FRAME


def rigid_torques(model: Any, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the rigid torques (N, n) of a ``pinocchio.Model`` along a path (N, n), N·m."""
    import pinocchio as pin

    tau: Array = pin.rneaInParallel(1, pin.ModelPool(model, 1), q.T, dq.T, ddq.T).T
    return tau


def wrench_torque(model: Any, data: Any, q: Array, wrench: Array) -> Array:
    """Return Jᵀ·F (n,) of a wrench [m; f] (6,) that the tool exerts at its origin, base axes."""
    import pinocchio as pin

    frame = model.getFrameId(TOOL_FRAME)
    jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    torque: Array = jacobian.T @ np.concatenate([wrench[3:], wrench[:3]])
    return torque
