"""Zero offset of a joint encoder."""

import casadi as ca

from lieid_casadi.effects.arm_effect import ArmEffect, Array, InstantModel, SegmentModel
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register

LEAST = 1e-4  # rad; smallest step of the difference quotient


@register
class EncoderOffset(ArmEffect):
    """The true angle is the measured angle plus an offset: q_true = q + δ, δ in rad.

    The torques of other joints change, too. An offset about a vertical first axis has no effect.
    """

    name = "encoder_offset"
    finding = ("The zero of the position of {joints} is wrong",)
    change = ("The zero of the position of {joints} has moved",)
    formula = "q_true = q + δ"
    coefficients = (Coefficient("delta", "rad", limit=0.5, meaning="zero offset"),)
    revealed_by = "gravity torque in poses spread over the range of this joint and its neighbours"
    confused_with = {
        "base_tilt": "both turn gravity; a tilt acts on all joints",
        "position_spring": "similar over a small range of positions; use the whole range",
        "payload": "both change gravity torques; use the whole range of poses",
    }
    typical = "0.1 to 2° after the replacement of a drive"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        q, dq, ddq = arm.motion
        step = float(_step(ca.SX(ca.DM(values))))
        moved = q.copy()
        moved[:, joint] += step
        change = arm.rigid(moved, dq, ddq) - arm.load
        return change[:, :, None] / step

    def instant_columns(self, arm: InstantModel, joint: int, values: ca.SX) -> ca.SX:
        offset, step = ca.SX(arm.load.shape[0], 1), _step(values)
        offset[joint] = step
        return (arm.rigid_beside(offset) - arm.load) / step


def _step(values: ca.SX) -> ca.SX:
    """Return the offset over which the difference is taken, rad."""
    return ca.if_else(ca.fabs(values[0]) > LEAST, values[0], LEAST)
