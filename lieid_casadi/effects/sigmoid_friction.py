"""The sigmoid friction model published for the Franka Panda."""

from typing import ClassVar

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, Shape, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class SigmoidFriction(Effect):
    """Friction that rises smoothly through zero speed and levels out.

    τ = φ1/(1 + e^{−φ2·(q̇+φ3)}) − φ1/(1 + e^{−φ2·φ3}), with φ1 in N·m, φ2 in s/rad, φ3 in rad/s; it
    is zero at rest, and φ3 makes the two directions unequal. Replaces `coulomb` and `viscous`.
    """

    name = "sigmoid_friction"
    finding: ClassVar = ("Friction on {joints} changes smoothly with the direction",)
    change: ClassVar = finding
    formula = "φ1/(1 + e^{−φ2·(q̇+φ3)}) − φ1/(1 + e^{−φ2·φ3})"
    coefficients = (Coefficient("phi1", "N·m", meaning="friction from one direction to the other"),)
    shapes = (
        Shape("phi2", "s/rad", 8.0, 0.5, 200.0, meaning="steepness at rest"),
        Shape("phi3", "rad/s", 0.0, -0.3, 0.3, meaning="shift that makes the directions unequal"),
    )
    signals = ("dq",)
    dry = True
    replaces = ("coulomb", "viscous")
    candidate = False
    revealed_by = "motion at low and high speed in both directions"
    confused_with: ClassVar = {
        "coulomb": "the two are the same where φ2 is large",
        "viscous": "the two are the same where φ2 is small",
    }
    typical = "φ1 of 0.3 to 1.3 N·m, φ2 of 5 to 17 s/rad (Panda)"
    references = ("Gaz, Cognetti, Oliva, Robuffo Giordano, De Luca, IEEE RA-L 4(4), 2019",)

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        steep, shift = shape["phi2"], shape["phi3"]
        # 1/(1 + e^{−x}) = (1 + tanh(x/2))/2, which does not overflow
        return [(ca.tanh(steep * (s.dq + shift) / 2) - ca.tanh(steep * shift / 2)) / 2]
