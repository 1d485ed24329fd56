"""Stribeck friction: more friction at low speed (Eqs. 6-7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Shape, Signals, register
from lieid_casadi.errors import EffectError

ROUNDED = 1e-6  # added to (q̇/v_s)²: a power below 2 has no slope at rest without it


class Stribeck(Effect):
    """What static friction exceeds Coulomb friction by, fading with velocity.

    Beside `coulomb`. Options: ``exponent``, Eq. 6 with its exponent δ_s free (2 otherwise);
    ``two_width``, Eq. 7, where Coulomb friction rises as the static friction falls, each with
    its own width: in place of `coulomb`.
    """

    name = "stribeck"
    signals: tuple[str, ...] = ("dq", "sign")

    def __init__(self, *, option: str = "") -> None:
        self.option = option
        width = Shape("v_s", "rad/s", 0.1, 1e-3, 2.0)
        self.coefficients = (Coefficient("f_s-f_c", "N·m"),)
        if option == "":
            self.formula = "(f_s − f_c)·sgn(q̇)·e^{−(q̇/v_s)²}"
            self.shapes = (width,)
        elif option == "exponent":
            self.formula = "(f_s − f_c)·sgn(q̇)·e^{−|q̇/v_s|^δ_s}"
            self.shapes = (width, Shape("delta_s", "1", 2.0, 0.3, 5.0))
        elif option == "two_width":
            self.formula = "sgn(q̇)·(f_c·(1 − e^{−(q̇/v_c)²}) + f_s·e^{−(q̇/v_s)²})"
            self.coefficients = (Coefficient("f_c", "N·m"), Coefficient("f_s", "N·m"))
            self.shapes = (Shape("v_c", "rad/s", 0.02, 1e-3, 2.0), width)
        else:
            raise EffectError(f"stribeck has no option {option!r}; expected exponent or two_width")

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        ratio = (s.dq / shape["v_s"]) ** 2
        if self.option == "exponent":
            return [s.sign * ca.exp(-((ratio + ROUNDED) ** (shape["delta_s"] / 2)))]
        fading = s.sign * ca.exp(-ratio)
        if self.option == "two_width":
            return [-s.sign * ca.expm1(-((s.dq / shape["v_c"]) ** 2)), fading]
        return [fading]


register(Stribeck, options=["exponent", "two_width"])
