"""A wrong gain of a torque sensor or a wrong drive constant."""

import casadi as ca

from lieid_casadi.effects.arm_effect import ArmEffect, Array, InstantModel, SegmentModel, on_joint
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register


@register
class TorqueGain(ArmEffect):
    """The measured torque is (1 + g) times the torque: τ_measured = (1 + g)·τ.

    g is dimensionless and relative to the other joints: a gain common to all joints cannot be
    distinguished from larger masses.
    """

    name = "torque_gain"
    finding = (
        "The measured torque of {joints} is too large",
        "The measured torque of {joints} is too small",
    )
    change = (
        "The measured torque of {joints} has become larger",
        "The measured torque of {joints} has become smaller",
    )
    formula = "τ_measured = (1 + g)·τ"
    size_unit = "%"
    coefficients = (Coefficient("g", "1", limit=1.0, meaning="relative error of the gain"),)
    reach = "joint"
    linear = True
    revealed_by = "large gravity torque on several joints, or a payload of known mass"
    confused_with = {
        "load_friction": "only friction changes sign with the velocity; drive both directions",
        "payload": "a payload changes all joints before it; use the whole range of poses",
    }
    typical = "1 to 10 %"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        return on_joint(arm.torque[:, joint], joint, arm.torque.shape[1])

    def instant_columns(self, arm: InstantModel, joint: int, values: ca.SX) -> ca.SX:
        column = ca.SX(arm.torque.shape[0], 1)
        column[joint] = arm.torque[joint]
        return column
