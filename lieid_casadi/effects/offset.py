"""Constant torque (Eq. 10)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Signals, register


@register
class Offset(Effect):
    """A constant torque: sensor offset, unequal friction of the two directions."""

    name = "offset"
    formula = "f_b"
    coefficients = (Coefficient("f_b", "N·m"),)
    signals = ()
    energy = "offset"

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        return [ca.SX(1)]
