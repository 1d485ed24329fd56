"""Friction that changes with the joint's temperature."""

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, Shape, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class TemperatureFriction(Effect):
    """Change of viscous and dry friction with temperature; beside `viscous` and `coulomb`.

    τ = f_Tv·(T − T̄)·q̇ + f_Tc·(T − T̄)·sgn(q̇), with T in °C from a ``temp`` column and T̄ the
    mean of the training recordings; f_Tv in N·m·s/(rad·°C), f_Tc in N·m/°C.
    """

    name = "temperature_friction"
    finding = (
        "Friction on {joints} grows with temperature",
        "Friction on {joints} falls with temperature",
    )
    options = {
        "exponential": (
            "viscous friction that falls exponentially with temperature, as lubricants do "
            "(Vogel, Reynolds); replaces viscous, or, beside it, is the part that falls"
        )
    }
    signals: tuple[str, ...] = ("dq", "sign", "temperature")
    revealed_by = "the same motion with a cold and a warm joint, 10 °C apart or more"
    confused_with = {
        "warm_up": "similar while the temperature rises steadily; record several starts",
        "viscous": "at one temperature the two are the same",
    }
    typical = "viscous friction falls by 1 to 5 % per °C"
    references = (
        "Gao et al., IROS 2017",
        "Bittencourt, Axelsson, Jung, Brogårdh, Modeling and Identification of Wear, IFAC 2011",
    )

    def __init__(self, *, option: str = "") -> None:
        super().__init__(option=option)
        self.formula = "f_Tv·(T − T̄)·q̇ + f_Tc·(T − T̄)·sgn(q̇)"
        self.coefficients = (
            Coefficient("f_Tv", "N·m·s/(rad·°C)", meaning="viscous friction per °C"),
            Coefficient("f_Tc", "N·m/°C", meaning="dry friction per °C"),
        )
        if option == "exponential":
            self.formula = "f_v·e^{−β·(T − T̄)}·q̇"
            self.coefficients = (Coefficient("f_v", "N·m·s/rad", meaning="viscous friction at T̄"),)
            self.shapes = (Shape("beta", "1/°C", 0.02, 1e-4, 0.3, meaning="relative decay per °C"),)
            self.signals = ("dq", "temperature")
            self.replaces = self.counted_as = ("viscous",)

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        if self.option == "exponential":
            return [ca.exp(-shape["beta"] * s.temperature) * s.dq]
        return [s.temperature * s.dq, s.temperature * s.sign]
