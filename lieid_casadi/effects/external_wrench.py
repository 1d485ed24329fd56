"""A constant wrench at the tool."""

import casadi as ca

from lieid_casadi.effects.arm_effect import ArmEffect, Array, InstantModel, SegmentModel
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register


@register
class ExternalWrench(ArmEffect):
    """A constant wrench that the tool exerts on its surroundings: τ = Jᵀ·[m; f].

    Moment m (3,) in N·m and force f (3,) in N at the tool's origin, in base axes. Revealed by
    motion while the contact or cable force is constant.
    """

    name = "external_wrench"
    finding = ("A constant force acts on the tool",)
    formula = "+Jᵀ·[m; f]"
    coefficients = (
        *(Coefficient(f"m{x}", "N·m", limit=1e4, meaning=f"moment about {x}") for x in "xyz"),
        *(Coefficient(f"f{x}", "N", limit=1e4, meaning=f"force along {x}") for x in "xyz"),
    )
    whole_arm = True
    on_measurement = False
    linear = True
    revealed_by = "motion through the workspace while the wrench is constant"
    confused_with = {
        "payload": "a vertical force resembles a weight at the tool's origin; accelerate the tool",
        "offset": "similar over a small range of poses; use the whole range",
    }
    typical = "hoses and cables 1 to 20 N"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        return arm.jacobian().transpose(0, 2, 1)

    def instant_columns(self, arm: InstantModel, joint: int, values: ca.SX) -> ca.SX:
        return arm.jacobian().T
