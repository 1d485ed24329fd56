"""Torque that repeats with the joint angle: cogging, gears, eccentric bearings."""

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, Shape, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class TorqueRipple(Effect):
    """One harmonic of the joint angle: τ = a·sin(kq) + b·cos(kq), of order 2 and above.

    a and b in N·m, k in 1/rad; order 1 cannot be distinguished from gravity.
    """

    name = "torque_ripple"
    finding = ("The torque of {joints} ripples over the joint angle",)
    change = ("The ripple of the torque of {joints} over the joint angle has changed",)
    formula = "a·sin(kq) + b·cos(kq)"
    coefficients = (
        Coefficient("a", "N·m", meaning="sine part"),
        Coefficient("b", "N·m", meaning="cosine part"),
    )
    shapes = (Shape("k", "1/rad", 6.0, 1.9, 400.0, scan=0.25, meaning="periods per turn"),)
    signals = ("q",)
    revealed_by = "slow motion through at least one period, sampled 5 times per period or more"
    confused_with = {
        "position_friction": "friction changes sign with the direction; drive both",
        "position_spring": "similar over less than a period; use the whole range",
    }
    typical = "1 to 5 % of the torque limit; harmonic drives have orders of 100 to 320"
    references = ("Tuttle, Seering, IEEE Trans. Robot. Autom. 12(3), 1996",)

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        phase = shape["k"] * s.q
        return [ca.sin(phase), ca.cos(phase)]
