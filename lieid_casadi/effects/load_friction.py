"""Friction that grows with the load on the joint (Eq. 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Shape, Signals, register
from lieid_casadi.errors import EffectError

REST_SPEED = 1e-3  # ε, rad/s: Eq. 8 has no limit at q̇ = τ_load = 0, √(q̇² + ε²) gives it one


class LoadFriction(Effect):
    """Dry friction in proportion to the joint's load.

    τ_load is the model's rigid torque, iterated to a fixed point, never the measured one.

    Options
    -------
    paper
        Both terms of Eq. 8, with |q̇| written as √(q̇² + ε²).
    motoring
        One coefficient where the load is driven and one where it drives (Hamon, Gautier,
        Garrec, IROS 2010).
    square
        In proportion to τ_load² (AURT, Madsen et al.).
    stribeck
        A part of it fades with velocity (Bittencourt et al., IROS 2010, with exponent 2).
    """

    name = "load_friction"
    signals: tuple[str, ...] = ("sign", "load")

    def __init__(self, *, option: str = "") -> None:
        self.option = option
        self.coefficients = (Coefficient("f_tau", "1"),)
        if option == "":
            self.formula = "f_τ·|τ_load|·sgn(q̇)"
        elif option == "paper":
            self.formula = (
                "(f_τ·|τ_load| + f_τ1·e^{−f_τ2·|τ_load|/√(q̇²+ε²)})·sgn(q̇), "
                f"ε = {REST_SPEED:g} rad/s"
            )
            self.coefficients += (Coefficient("f_tau1", "N·m"),)
            self.shapes = (Shape("f_tau2", "rad/(N·m·s)", 0.01, 1e-5, 1.0),)
            self.signals = ("dq", "sign", "load")
        elif option == "motoring":
            self.formula = "(f_m or f_g, by the sign of τ_load·q̇)·|τ_load|·sgn(q̇)"
            self.coefficients = (Coefficient("f_motor", "1"), Coefficient("f_generator", "1"))
        elif option == "square":
            self.formula = "f_τ²·τ_load²·sgn(q̇)"
            self.coefficients = (Coefficient("f_tau_square", "1/(N·m)"),)
        elif option == "stribeck":
            self.formula = "(f_τ + f_τs·e^{−(q̇/v_τ)²})·|τ_load|·sgn(q̇)"
            self.coefficients += (Coefficient("f_tau_s", "1"),)
            self.shapes = (Shape("v_tau", "rad/s", 0.1, 1e-3, 2.0),)
            self.signals = ("dq", "sign", "load")
        else:
            raise EffectError(
                f"load_friction has no option {option!r}; expected paper, motoring, square or "
                "stribeck"
            )

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        size = ca.fabs(s.load)
        if self.option == "paper":
            speed = ca.sqrt(s.dq**2 + REST_SPEED**2)
            return [size * s.sign, ca.exp(-shape["f_tau2"] * size / speed) * s.sign]
        if self.option == "motoring":
            driven = (s.load * s.sign + size) / 2
            return [driven * s.sign, (size - driven) * s.sign]
        if self.option == "square":
            return [s.load**2 * s.sign]
        if self.option == "stribeck":
            return [size * s.sign, size * s.sign * ca.exp(-((s.dq / shape["v_tau"]) ** 2))]
        return [size * s.sign]


register(LoadFriction, options=["paper", "motoring", "square", "stribeck"])
