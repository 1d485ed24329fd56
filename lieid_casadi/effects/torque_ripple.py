"""Torque that repeats along the turn: cogging, gears, eccentric bearings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Shape, Signals, register


@register
class TorqueRipple(Effect):
    """One harmonic of the joint angle, of any order from 2 up; the first ones look like gravity."""

    name = "torque_ripple"
    formula = "a·sin(kq) + b·cos(kq)"
    coefficients = (Coefficient("a", "N·m"), Coefficient("b", "N·m"))
    shapes = (Shape("k", "1/rad", 6.0, 1.9, 400.0, scan=0.25),)
    signals = ("q",)

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        phase = shape["k"] * s.q
        return [ca.sin(phase), ca.cos(phase)]
