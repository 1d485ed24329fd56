"""Constant torque (Luo et al. 2024, Eq. 10)."""

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class Offset(Effect):
    """A constant torque τ = f_b, in N·m: zero error of a torque sensor, unequal friction."""

    name = "offset"
    finding = ("A constant torque acts on {joints}",)
    change = ("The constant torque on {joints} has {increased}",)
    formula = "f_b"
    coefficients = (Coefficient("f_b", "N·m", meaning="constant torque"),)
    signals = ()
    energy = "offset"
    revealed_by = "motion through a wide range of positions, in both directions"
    confused_with = {
        "position_spring": "similar over a small range of positions; use the whole range",
        "bias_drift": "similar over a short recording; record longer",
        "base_tilt": "similar on joints whose gravity torque changes little; use the whole range",
    }
    typical = "up to a few per cent of the torque limit"
    references = ("Luo et al., Robotica 2024, Eq. 10",)

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        return [ca.SX(1)]
