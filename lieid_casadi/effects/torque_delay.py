"""A torque that is recorded late."""

from __future__ import annotations

import casadi as ca
import numpy as np

from lieid_casadi.effects.arm_effect import ArmAlong, ArmEffect, ArmNow, Array, on_joint
from lieid_casadi.effects.effect import Coefficient, register

LEAST = 1e-3  # s: below it the derivative stands for the difference


@register
class TorqueDelay(ArmEffect):
    """What is measured at t is the torque at t − δ."""

    name = "torque_delay"
    formula = "τ_measured(t) = τ(t − δ)"
    coefficients = (Coefficient("delta", "s"),)
    reach = "joint"
    in_code = "left out: the torque is that of the instant, without the delay of its measurement"
    starts = ((-0.02,), (-0.005,), (0.005,), (0.01,), (0.02,), (0.04,), (0.08,))

    def along(self, arm: ArmAlong, joint: int, values: Array) -> Array:
        """See the class."""
        delay = float(values[0])
        torque = arm.torque[:, joint]
        if abs(delay) < LEAST:
            late, early = (np.interp(arm.t + s * LEAST, arm.t, torque) for s in (-1.0, 1.0))
            change = (late - early) / (2.0 * LEAST)
        else:
            change = (np.interp(arm.t - delay, arm.t, torque) - torque) / delay
        return on_joint(change, joint, arm.torque.shape[1])

    def now(self, arm: ArmNow, joint: int, values: Array) -> ca.SX:
        """Return zeros: a controller wants the torque that the drive delivers now."""
        return ca.SX(arm.load.shape[0], 1)
