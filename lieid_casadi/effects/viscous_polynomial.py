"""Nonlinear viscous friction (Luo et al. 2024, Eq. 17)."""

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class ViscousPolynomial(Effect):
    """Second and third power of velocity beside `viscous`: τ = f_v2·sgn(q̇)·q̇² + f_v3·q̇³.

    Units: f_v2 in N·m·s²/rad², f_v3 in N·m·s³/rad³.
    """

    name = "viscous_polynomial"
    finding = ("Friction on {joints} is not a straight line over speed",)
    change = ("The curve of friction over speed on {joints} has changed",)
    formula = "f_v2·sgn(q̇)·q̇² + f_v3·q̇³"
    coefficients = (
        Coefficient("f_v2", "N·m·s²/rad²", meaning="friction per square of velocity"),
        Coefficient("f_v3", "N·m·s³/rad³", meaning="friction per cube of velocity"),
    )
    signals = ("dq", "sign")
    revealed_by = "motion from low speed to the joint's top speed"
    confused_with = {
        "stribeck": "both change friction over speed; only Stribeck friction falls at low speed",
        "temperature_friction": "fast motion warms the joint; repeat it at another temperature",
    }
    typical = "10 to 30 % of the friction at top speed; grease shear-thins, so f_v3 is often < 0"
    references = ("Luo et al., Robotica 2024, Eq. 17",)

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        return [s.sign * s.dq**2, s.dq**3]
