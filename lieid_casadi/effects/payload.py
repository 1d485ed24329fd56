"""A body at the tool."""

from __future__ import annotations

import casadi as ca

from lieid_casadi.effects.arm_effect import ArmAlong, ArmEffect, ArmNow, Array
from lieid_casadi.effects.effect import Coefficient, register


@register
class Payload(ArmEffect):
    """Mass and first moment of a small body in the tool's frame.

    Its inertia about the tool's origin is neglected. In a fit of the last link it is absorbed.
    """

    name = "payload"
    formula = "Y_tool·[m, m·c]"
    coefficients = (
        Coefficient("m", "kg"),
        *(Coefficient(f"mc{axis}", "kg·m") for axis in "xyz"),
    )
    whole_arm = True

    def along(self, arm: ArmAlong, joint: int, values: Array) -> Array:
        """See the class."""
        return arm.tool_regressor()[:, :, :4]

    def now(self, arm: ArmNow, joint: int, values: Array) -> ca.SX:
        """See the class."""
        return arm.tool_regressor()[:, :4]
