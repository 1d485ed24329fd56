"""Dry friction that varies along the turn: eccentric gears, cables that wind up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Shape, Signals, register


@register
class PositionFriction(Effect):
    """One harmonic of dry friction over the joint angle. Beside `coulomb`."""

    name = "position_friction"
    formula = "(f_sin·sin kq + f_cos·cos kq)·sgn(q̇)"
    coefficients = (Coefficient("f_sin", "N·m"), Coefficient("f_cos", "N·m"))
    shapes = (Shape("k", "1/rad", 1.0, 0.5, 8.0),)
    signals = ("q", "sign")

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        phase = shape["k"] * s.q
        return [ca.sin(phase) * s.sign, ca.cos(phase) * s.sign]
