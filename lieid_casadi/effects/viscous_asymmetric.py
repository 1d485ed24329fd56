"""Viscous friction that differs between the two directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Signals, register


@register
class ViscousAsymmetric(Effect):
    """Half the difference of the two directions' viscous coefficients."""

    name = "viscous_asymmetric"
    formula = "f·|q̇|"
    coefficients = (Coefficient("f", "N·m·s/rad"),)
    signals = ("dq", "sign")

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        return [s.sign * s.dq]
