"""Friction that changes while the joint warms up, without a measured temperature."""

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, Shape, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class WarmUp(Effect):
    """Change of viscous and dry friction with the time since the segment began.

    τ = (f_tv·q̇ + f_tc·sgn(q̇))·(1 − e^{−t/θ}), with f_tv in N·m·s/rad, f_tc in N·m, θ and t in s.
    Beside `viscous` and `coulomb`, which are then the friction of the cold joint.
    """

    name = "warm_up"
    unless_measured = "temperature"
    finding = (
        "Friction on {joints} increases in the course of a recording",
        "Friction on {joints} decreases in the course of a recording, as in a gear that warms up",
    )
    formula = "(f_tv·q̇ + f_tc·sgn(q̇))·(1 − e^{−t/θ})"
    coefficients = (
        Coefficient("f_tv", "N·m·s/rad", meaning="change of viscous friction, warm minus cold"),
        Coefficient("f_tc", "N·m", meaning="change of dry friction, warm minus cold"),
    )
    shapes = (
        Shape("theta", "s", 300.0, 1.0, 2e4, meaning="time constant", resolved_by="duration"),
    )
    signals = ("dq", "sign", "time")
    revealed_by = "a cold start and a recording of at least one time constant at working speed"
    confused_with = {
        "temperature_friction": "similar while the temperature rises steadily; use a temp column",
        "bias_drift": "both grow with time; only warm-up changes sign with the velocity",
    }
    typical = "friction falls by 10 to 40 % over 5 to 60 min"
    references = ("Simoni, Beschi, Legnani, Visioli, IROS 2015",)

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        warm = -ca.expm1(-s.time / shape["theta"])
        return [warm * s.dq, warm * s.sign]
