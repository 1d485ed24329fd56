"""Dry friction that varies with position: eccentric gears, cables."""

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, Shape, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class PositionFriction(Effect):
    """One harmonic of dry friction over the joint angle; beside `coulomb`.

    τ = (f_sin·sin kq + f_cos·cos kq)·sgn(q̇), with f_sin and f_cos in N·m and k in 1/rad.
    """

    name = "position_friction"
    finding = ("Dry friction on {joints} varies with the joint angle",)
    change = ("The variation of dry friction on {joints} with the angle has changed",)
    formula = "(f_sin·sin kq + f_cos·cos kq)·sgn(q̇)"
    coefficients = (
        Coefficient("f_sin", "N·m", meaning="sine part of the dry friction"),
        Coefficient("f_cos", "N·m", meaning="cosine part of the dry friction"),
    )
    shapes = (Shape("k", "1/rad", 1.0, 0.5, 8.0, meaning="periods per turn"),)
    signals = ("q", "sign")
    revealed_by = "slow motion in both directions through the joint's whole range"
    confused_with = {
        "load_friction": "gravity varies with position, too; repeat the motion with a payload",
        "torque_ripple": "ripple has the same sign in both directions; drive both",
    }
    typical = "10 to 30 % of Coulomb friction"
    references = ("Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",)

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        phase = shape["k"] * s.q
        return [ca.sin(phase) * s.sign, ca.cos(phase) * s.sign]
