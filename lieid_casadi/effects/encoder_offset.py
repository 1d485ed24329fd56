"""A joint whose zero is not where the model has it."""

from __future__ import annotations

import casadi as ca
import numpy as np

from lieid_casadi.effects.arm_effect import ArmAlong, ArmEffect, ArmNow, Array
from lieid_casadi.effects.effect import Coefficient, register

LEAST = 1e-4  # rad: below it a difference over this much stands for the derivative


@register
class EncoderOffset(ArmEffect):
    """The true angle is the measured one plus δ; other joints feel it too."""

    name = "encoder_offset"
    formula = "q_true = q + δ"
    coefficients = (Coefficient("delta", "rad"),)

    def along(self, arm: ArmAlong, joint: int, values: Array) -> Array:
        """See the class."""
        q, dq, ddq = arm.motion
        step = _step(values)
        moved = q.copy()
        moved[:, joint] += step
        change = arm.rigid(moved, dq, ddq) - arm.load
        return change[:, :, None] / step

    def now(self, arm: ArmNow, joint: int, values: Array) -> ca.SX:
        """See the class."""
        offset, step = np.zeros(arm.load.shape[0]), _step(values)
        offset[joint] = step
        return (arm.rigid_beside(offset) - arm.load) / step


def _step(values: Array) -> float:
    """Return the offset over which the difference is taken, rad."""
    return float(values[0]) if abs(values[0]) > LEAST else LEAST
