"""A constant push or pull at the tool."""

from __future__ import annotations

import casadi as ca

from lieid_casadi.effects.arm_effect import ArmAlong, ArmEffect, ArmNow, Array
from lieid_casadi.effects.effect import Coefficient, register


@register
class ExternalWrench(ArmEffect):
    """A constant wrench that the tool exerts on its surroundings, base axes."""

    name = "external_wrench"
    formula = "+Jᵀ·[m; f]"
    coefficients = (
        *(Coefficient(f"m{axis}", "N·m") for axis in "xyz"),
        *(Coefficient(f"f{axis}", "N") for axis in "xyz"),
    )
    whole_arm = True

    def along(self, arm: ArmAlong, joint: int, values: Array) -> Array:
        """See the class."""
        return arm.jacobian().transpose(0, 2, 1)

    def now(self, arm: ArmNow, joint: int, values: Array) -> ca.SX:
        """See the class."""
        return arm.jacobian().T
