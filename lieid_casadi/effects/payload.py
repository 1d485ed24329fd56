"""A body attached to the tool."""

from collections.abc import Mapping

import casadi as ca

from lieid_casadi.effects.arm_effect import ArmEffect, Array, InstantModel, SegmentModel
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register


@register
class Payload(ArmEffect):
    """Mass and first moments of a body attached to the tool: τ = Y_tool·[m, m·c].

    m in kg, m·c (3,) in kg·m in the tool frame; the inertia about the tool's origin is neglected.
    In a fit with free link parameters it is absorbed by those of the last link; it is identifiable
    as a change of a fit.
    """

    name = "payload"
    finding = ("A body is attached to the tool",)
    change = ("The body at the tool has become heavier", "The body at the tool has become lighter")
    formula = "Y_tool·[m, m·c]"
    coefficients = (
        Coefficient("m", "kg", limit=500.0, meaning="mass"),
        *(Coefficient(f"mc{x}", "kg·m", meaning=f"first moment along {x}") for x in "xyz"),
    )
    whole_arm = True
    on_measurement = False
    linear = True
    revealed_by = "gravity torque in at least three orientations of the tool"
    confused_with = {
        "external_wrench": "similar over few orientations; a force keeps its direction",
        "torque_gain": "similar on a single joint; a payload acts on all joints before it",
    }
    typical = "up to the arm's rated payload"
    references = ("Swevers, Verdonck, De Schutter, IEEE Control Systems Magazine 27(5), 2007",)

    def size_text(self, parameters: Mapping[str, float]) -> str:
        """Return mass and centre of mass; a lost body has a negative mass."""
        mass = parameters["m"]
        if not mass:
            return ""
        com = ", ".join(f"{1000.0 * parameters[f'mc{x}'] / mass:z.0f}" for x in "xyz")
        return f"{abs(mass):.3g} kg, centre of mass at ({com}) mm in the tool frame"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        return arm.tool_regressor()[:, :, :4]

    def instant_columns(self, arm: InstantModel, joint: int, values: ca.SX) -> ca.SX:
        return arm.tool_regressor()[:, :4]

    def tool_body(self, values: ca.SX) -> ca.SX:
        """Return mass and first moments, with an inertia of zero."""
        return ca.vertcat(values, ca.SX(6, 1))
