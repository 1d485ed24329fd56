"""Inertia of the rotor and gear, seen at the joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Signals, register


@register
class Armature(Effect):
    """Reflected rotor inertia."""

    name = "armature"
    formula = "I_a·q̈"
    coefficients = (Coefficient("I_a", "kg·m²", lower=0.0),)
    signals = ("ddq",)
    energy = "armature"

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        return [s.ddq]
