"""A spring across the joint: balancer, hose, cable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Signals, register


@register
class PositionSpring(Effect):
    """Torque in proportion to the angle; beside `offset`, which has the spring's rest angle."""

    name = "position_spring"
    formula = "K·q"
    coefficients = (Coefficient("K", "N·m/rad"),)
    signals = ("q",)

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        return [s.q]
