"""Friction that changes with the joint's temperature."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Shape, Signals, register
from lieid_casadi.errors import EffectError


class TemperatureFriction(Effect):
    """Change of viscous and dry friction with temperature, from a ``temp`` column.

    T̄ is the mean of the training recordings. Beside `viscous` and `coulomb`. The option
    ``exponential`` is viscous friction that falls exponentially with warmth, as lubricants do
    (Vogel, Reynolds): in place of `viscous`; beside it, the part that does not fall.
    """

    name = "temperature_friction"
    signals: tuple[str, ...] = ("dq", "sign", "temperature")

    def __init__(self, *, option: str = "") -> None:
        self.option = option
        if option == "":
            self.formula = "f_Tv·(T − T̄)·q̇ + f_Tc·(T − T̄)·sgn(q̇)"
            self.coefficients = (
                Coefficient("f_Tv", "N·m·s/(rad·°C)"),
                Coefficient("f_Tc", "N·m/°C"),
            )
        elif option == "exponential":
            self.formula = "f_v·e^{−β·(T − T̄)}·q̇"
            self.coefficients = (Coefficient("f_v", "N·m·s/rad"),)
            self.shapes = (Shape("beta", "1/°C", 0.02, 1e-4, 0.3),)
            self.signals = ("dq", "temperature")
        else:
            raise EffectError(
                f"temperature_friction has no option {option!r}; expected exponential"
            )

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        if self.option == "exponential":
            return [ca.exp(-shape["beta"] * s.temperature) * s.dq]
        return [s.temperature * s.dq, s.temperature * s.sign]


register(TemperatureFriction, options=["exponential"])
