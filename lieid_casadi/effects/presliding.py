"""Hysteresis of friction at reversals: Dahl and LuGre, integrated exactly over each step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Shape, Signals, State, register
from lieid_casadi.errors import EffectError


class Presliding(Effect):
    """Dry friction that builds up over a width w of motion after each reversal.

    In place of `coulomb`: z/w takes the place of the sign. The bristle's deflection obeys
    dz/dq = 1 − s·z/w, s = sgn(dq) (Dahl, 1968), whose solution over a step in one direction is

        z ← s·w + (z − s·w)·e^{−|Δq|/w},

    the same for one long step as for many short ones. z = 0 where a segment begins.

    Options
    -------
    load, square
        A further part in proportion to |τ_load| or τ_load².
    lugre
        Canudas de Wit et al., IEEE TAC 1995: the width is g(q̇)/σ0 and follows the Stribeck
        curve, w·(1 + r·e^{−(q̇/v_s)²}) at the mean velocity of a step, and σ1·ż damps the
        bristle. Beside `viscous`.
    """

    name = "presliding"
    states = (State("z", "rad"),)
    dry = True  # at rest the drive may hold more or less than the bristle says

    def __init__(self, *, option: str = "") -> None:
        self.option = option
        self.coefficients = (Coefficient("f_c", "N·m", lower=0.0),)
        self.shapes = (Shape("w", "rad", 0.01, 1e-4, 0.5),)
        self.signals = ("q", "dq", "time")
        if option == "":
            self.formula = "f_c·z/w, dz/dq = 1 − sgn(q̇)·z/w"
        elif option in ("load", "square"):
            power = "|τ_load|" if option == "load" else "τ_load²"
            self.formula = f"(f_c + f_τ·{power})·z/w, dz/dq = 1 − sgn(q̇)·z/w"
            name, unit = ("f_tau", "1") if option == "load" else ("f_tau_square", "1/(N·m)")
            self.coefficients += (Coefficient(name, unit),)
            self.signals = ("q", "dq", "load", "time")
        elif option == "lugre":
            self.formula = "f_c·z/w + σ1·ż, ż = q̇ − |q̇|·z/(w·(1 + r·e^{−(q̇/v_s)²}))"
            self.coefficients += (Coefficient("sigma1", "N·m·s/rad", lower=0.0),)
            self.shapes += (Shape("r", "1", 0.3, 1e-2, 5.0), Shape("v_s", "rad/s", 0.1, 1e-3, 2.0))
        else:
            raise EffectError(
                f"presliding has no option {option!r}; expected load, square or lugre"
            )

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        built = s.state["z"] / shape["w"]
        if self.option == "load":
            return [built, built * ca.fabs(s.load)]
        if self.option == "square":
            return [built, built * s.load**2]
        if self.option == "lugre":
            return [built, s.dq - ca.fabs(s.dq) * s.state["z"] / self._width(s.dq, shape)]
        return [built]

    def advance(self, before: Signals, now: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        moved, width = now.q - before.q, self._width((before.dq + now.dq) / 2, shape)
        first = _until_reversal(before, now)
        return [_slide(_slide(before.state["z"], first, width), moved - first, width)]

    def _width(self, dq: ca.SX, shape: Mapping[str, ca.SX]) -> ca.SX:
        if self.option != "lugre":
            return shape["w"]
        return shape["w"] * (1 + shape["r"] * ca.exp(-((dq / shape["v_s"]) ** 2)))


def _slide(z: ca.SX, moved: ca.SX, width: ca.SX) -> ca.SX:
    """Return the deflection after a motion in one direction."""
    relative = ca.fabs(moved) / width
    return z * ca.exp(-relative) - ca.sign(moved) * width * ca.expm1(-relative)


def _until_reversal(before: Signals, now: Signals) -> ca.SX:
    """Return the motion up to a reversal within the step; 0 without one.

    The velocity is taken to pass through zero linearly.
    """
    turns = before.dq * now.dq < 0
    total = ca.if_else(turns, ca.fabs(before.dq) + ca.fabs(now.dq), 1)
    return turns * before.dq * ca.fabs(before.dq) / total * (now.time - before.time) / 2


register(Presliding, options=["load", "square", "lugre"])
