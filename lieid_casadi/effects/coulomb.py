"""Coulomb friction (Eq. 10)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Signals, register


@register
class Coulomb(Effect):
    """Dry friction of constant size against the motion."""

    name = "coulomb"
    formula = "f_c·sgn(q̇)"
    coefficients = (Coefficient("f_c", "N·m"),)
    signals = ("sign",)

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        return [s.sign]
