"""Dry friction that varies along the turn: eccentric gears, cables that wind up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Signals, register


@register
class PositionFriction(Effect):
    """First harmonic of dry friction over the joint angle. Beside `coulomb`."""

    name = "position_friction"
    formula = "(f_sin·sin q + f_cos·cos q)·sgn(q̇)"
    coefficients = (Coefficient("f_sin", "N·m"), Coefficient("f_cos", "N·m"))
    signals = ("q", "sign")

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        return [ca.sin(s.q) * s.sign, ca.cos(s.q) * s.sign]
