"""Stribeck friction: more friction at low speed (Eqs. 6-7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Shape, Signals, register
from lieid_casadi.errors import EffectError


class Stribeck(Effect):
    """What static friction exceeds Coulomb friction by, fading with velocity.

    Beside `coulomb`. The option ``two_width`` is Eq. 7, where Coulomb friction rises as the
    static friction falls, each with its own width.
    """

    name = "stribeck"
    signals = ("dq", "sign")

    def __init__(self, *, option: str = "") -> None:
        if option not in ("", "two_width"):
            raise EffectError(f"stribeck has no option {option!r}; expected two_width")
        self.option = option
        width = Shape("v_s", "rad/s", 0.1, 1e-3, 2.0)
        if option == "two_width":
            self.formula = "sgn(q̇)·(f_s·e^{−(q̇/v_s)²} − f_r·e^{−(q̇/v_c)²})"
            self.coefficients = (Coefficient("f_s", "N·m"), Coefficient("f_r", "N·m"))
            self.shapes = (width, Shape("v_c", "rad/s", 0.02, 1e-3, 2.0))
        else:
            self.formula = "(f_s − f_c)·sgn(q̇)·e^{−(q̇/v_s)²}"
            self.coefficients = (Coefficient("f_s-f_c", "N·m"),)
            self.shapes = (width,)

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        fading = [s.sign * ca.exp(-((s.dq / shape["v_s"]) ** 2))]
        if self.option == "two_width":
            fading.append(-s.sign * ca.exp(-((s.dq / shape["v_c"]) ** 2)))
        return fading


register(Stribeck, options=["two_width"])
