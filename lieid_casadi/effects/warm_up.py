"""Friction that changes while the joint warms up, where no temperature was recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Shape, Signals, register


@register
class WarmUp(Effect):
    """Change of viscous and dry friction with time since the segment began.

    Beside `viscous` and `coulomb`, which are then the friction of the cold joint.
    """

    name = "warm_up"
    formula = "(f_tv·q̇ + f_tc·sgn(q̇))·(1 − e^{−t/θ})"
    coefficients = (Coefficient("f_tv", "N·m·s/rad"), Coefficient("f_tc", "N·m"))
    shapes = (Shape("theta", "s", 300.0, 1.0, 2e4),)
    signals = ("dq", "sign", "time")

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        warm = -ca.expm1(-s.time / shape["theta"])
        return [warm * s.dq, warm * s.sign]
