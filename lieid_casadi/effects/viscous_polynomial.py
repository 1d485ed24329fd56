"""Nonlinear viscous friction (Eq. 17)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Signals, register


@register
class ViscousPolynomial(Effect):
    """Second and third power of velocity; beside `viscous`."""

    name = "viscous_polynomial"
    formula = "f_v2·sgn(q̇)·q̇² + f_v3·q̇³"
    coefficients = (
        Coefficient("f_v2", "N·m·s²/rad²"),
        Coefficient("f_v3", "N·m·s³/rad³"),
    )
    signals = ("dq", "sign")

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        return [s.sign * s.dq**2, s.dq**3]
