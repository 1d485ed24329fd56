"""Friction that grows with the load on the joint (Luo et al. 2024, Eq. 8)."""

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, Shape, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register

REST_SPEED = 1e-3  # ε, rad/s: Eq. 8 has no limit at q̇ = τ_load = 0; √(q̇² + ε²) gives it one


@register
class LoadFriction(Effect):
    """Dry friction in proportion to the joint's load: τ = f_τ·|τ_load|·sgn(q̇).

    f_τ is dimensionless. τ_load is the model's rigid torque in N·m, iterated to a fixed point,
    never the measured torque.
    """

    name = "load_friction"
    finding = (
        "Friction on {joints} grows with the load",
        "Friction on {joints} falls with the load",
    )
    change = (
        "Friction on {joints} grows more with the load than before",
        "Friction on {joints} grows less with the load than before",
    )
    options = {
        "paper": "both terms of Eq. 8, with |q̇| written as √(q̇² + ε²)",
        "motoring": (
            "one coefficient when motoring and one when generating (Hamon, Gautier, "
            "Garrec, IROS 2010)"
        ),
        "square": "proportional to τ_load² (AURT, Madsen et al. 2020)",
        "stribeck": (
            "an additional term that falls with speed (Bittencourt et al., IROS 2010, exponent 2)"
        ),
    }
    size_unit = "N·m per N·m"
    signals: tuple[str, ...] = ("sign", "load")
    revealed_by = "both directions through poses of small and large gravity torque, or a payload"
    confused_with = {
        "coulomb": "under a constant load the two are the same; vary pose and payload",
        "torque_gain": "both scale with the load; only friction changes sign with the velocity",
        "position_friction": "gravity varies with position; repeat the motion with a payload",
    }
    typical = "f_τ of 0.02 to 0.15 with gears; near 0 with joint torque sensors"
    references = (
        "Luo et al., Robotica 2024, Eq. 8",
        "Hamon, Gautier, Garrec, IROS 2010",
        "Bittencourt et al., IROS 2010",
        "Madsen et al., Control Engineering Practice 2020",
    )

    def __init__(self, *, option: str = "") -> None:
        super().__init__(option=option)
        self.formula = "f_τ·|τ_load|·sgn(q̇)"
        self.coefficients = (
            Coefficient("f_tau", "1", limit=1.0, meaning="friction per load", opposes_motion=True),
        )
        if option == "paper":
            self.formula = (
                "(f_τ·|τ_load| + f_τ1·e^{−f_τ2·|τ_load|/√(q̇²+ε²)})·sgn(q̇), "
                f"ε = {REST_SPEED:g} rad/s"
            )
            self.coefficients += (
                Coefficient("f_tau1", "N·m", meaning="size of the exponential term"),
            )
            self.shapes = (
                Shape("f_tau2", "rad/(N·m·s)", 0.01, 1e-5, 1.0, meaning="decay with the load"),
            )
            self.signals = ("dq", "sign", "load")
        elif option == "motoring":
            self.formula = "(f_m or f_g, by the sign of τ_load·q̇)·|τ_load|·sgn(q̇)"
            self.coefficients = (
                Coefficient(
                    "f_motor", "1", limit=1.0, meaning="friction per load while driving it"
                ),
                Coefficient(
                    "f_generator", "1", limit=1.0, meaning="friction per load while driven by it"
                ),
            )
        elif option == "square":
            self.formula = "f_τ²·τ_load²·sgn(q̇)"
            self.coefficients = (
                Coefficient("f_tau_square", "1/(N·m)", meaning="friction per square of the load"),
            )
        elif option == "stribeck":
            self.formula = "(f_τ + f_τs·e^{−(q̇/v_τ)²})·|τ_load|·sgn(q̇)"
            self.coefficients += (
                Coefficient("f_tau_s", "1", meaning="part that decreases with speed"),
            )
            self.shapes = (
                Shape(
                    "v_tau", "rad/s", 0.1, 1e-3, 2.0,
                    meaning="speed over which it decreases", resolved_by="speed",
                ),
            )  # fmt: skip
            self.signals = ("dq", "sign", "load")

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
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
