"""Typical torques of a robot without torque limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.plant.rigid import build_pinocchio
from lieid_casadi.plant.trajectories import Envelope
from lieid_casadi.robot import Robot

Array = NDArray[np.float64]


def torque_scale(robot: Robot) -> Array:
    """Return the torque limit of each joint (n,), N·m; without one, 1.5 × a typical peak."""
    import pinocchio as pin

    limit = robot.limit("torque")
    if np.isfinite(limit).all():
        return limit
    envelope, random = Envelope.of(robot), np.random.default_rng(0)
    model = build_pinocchio(robot)
    data = model.createData()
    peak = np.zeros(robot.n)
    for _ in range(200):
        q = random.uniform(envelope.lower, envelope.upper)
        dq, ddq = random.uniform(-0.5, 0.5, (2, robot.n))
        tau = pin.rnea(model, data, q, dq * envelope.velocity, ddq * envelope.acceleration)
        peak = np.maximum(peak, np.abs(tau))
    return np.where(np.isfinite(limit), limit, 1.5 * peak)
