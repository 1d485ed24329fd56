"""A spring across the joint: balancer, hose, cable."""

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class PositionSpring(Effect):
    """Torque in proportion to the angle: τ = K·q, K in N·m/rad.

    Used beside `offset`, which contains the rest angle: −K·q₀.
    """

    name = "position_spring"
    finding = (
        "A torque on {joints} grows with the joint angle",
        "A torque on {joints} falls with the joint angle, as of a spring",
    )
    formula = "K·q"
    coefficients = (Coefficient("K", "N·m/rad", limit=2e4, meaning="stiffness"),)
    signals = ("q",)
    accompanied_by = ("offset",)
    revealed_by = "slow motion through the joint's whole range, also where gravity has no effect"
    confused_with = {
        "offset": "similar over a small range of positions; use the whole range",
        "encoder_offset": "similar where gravity is linear in the angle; use the whole range",
        "torque_ripple": "similar over less than a period of the ripple; use the whole range",
    }
    typical = "cables and hoses 0.1 to 5 N·m/rad; spring balancers up to the gravity torque"

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        return [s.q]
