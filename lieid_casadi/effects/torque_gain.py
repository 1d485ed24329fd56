"""A torque sensor or drive constant that is off by a factor."""

from __future__ import annotations

import casadi as ca

from lieid_casadi.effects.arm_effect import ArmAlong, ArmEffect, ArmNow, Array, on_joint
from lieid_casadi.effects.effect import Coefficient, register


@register
class TorqueGain(ArmEffect):
    """What is measured is (1 + g) times the torque; relative to the other joints' gains."""

    name = "torque_gain"
    formula = "τ_measured = (1 + g)·τ"
    coefficients = (Coefficient("g", "1"),)
    reach = "joint"

    def along(self, arm: ArmAlong, joint: int, values: Array) -> Array:
        """See the class."""
        return on_joint(arm.torque[:, joint], joint, arm.torque.shape[1])

    def now(self, arm: ArmNow, joint: int, values: Array) -> ca.SX:
        """See the class."""
        column = ca.SX(arm.torque.shape[0], 1)
        column[joint] = arm.torque[joint]
        return column
