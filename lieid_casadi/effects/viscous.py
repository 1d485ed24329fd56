"""Viscous friction (Eq. 10)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Signals, register


@register
class Viscous(Effect):
    """Friction in proportion to velocity."""

    name = "viscous"
    formula = "f_v·q̇"
    coefficients = (Coefficient("f_v", "N·m·s/rad"),)
    signals = ("dq",)

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        return [s.dq]
