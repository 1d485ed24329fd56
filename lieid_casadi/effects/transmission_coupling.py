"""Friction on one joint from another joint's motion: shared gears, coupled drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Signals, register


@register
class TransmissionCoupling(Effect):
    """Viscous and dry friction that joint j's motion makes on joint i."""

    name = "transmission_coupling"
    formula = "f_v·q̇_j + f_c·sgn(q̇_j)"
    coefficients = (Coefficient("f_v", "N·m·s/rad"), Coefficient("f_c", "N·m"))
    signals = ("dq", "sign")
    couples = True

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        assert s.other is not None  # placed on a pair of joints
        return [s.other.dq, s.other.sign]
