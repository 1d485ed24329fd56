"""Viscous friction (Luo et al. 2024, Eq. 10)."""

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class Viscous(Effect):
    """Friction in proportion to velocity: τ = f_v·q̇, f_v in N·m·s/rad."""

    name = "viscous"
    finding = ("Friction on {joints} grows with speed", "Friction on {joints} falls with speed")
    change = ("Viscous friction on {joints} has {increased}",)
    formula = "f_v·q̇"
    coefficients = (
        Coefficient("f_v", "N·m·s/rad", meaning="friction per velocity", opposes_motion=True),
    )
    signals = ("dq",)
    revealed_by = "motion at speeds from about 10 % to 100 % of the joint's limit, both directions"
    confused_with = {
        "coulomb": "at one speed the two are the same; use speeds that differ by a factor of 5",
        "viscous_polynomial": "similar over a narrow range of speeds; use the whole range",
        "temperature_friction": "at one temperature the two are the same",
        "torque_delay": "a delay of an accelerating torque resembles damping; vary the frequency",
    }
    typical = "comparable with Coulomb friction at half of the joint's top speed"
    references = (
        "Luo et al., Robotica 2024, Eq. 10",
        "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
    )

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        return [s.dq]
