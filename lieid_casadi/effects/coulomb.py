"""Coulomb friction (Luo et al. 2024, Eq. 10)."""

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class Coulomb(Effect):
    """Dry friction of constant size against the motion: τ = f_c·sgn(q̇), f_c in N·m.

    At rest it is undetermined: sgn(0) = 0.
    """

    name = "coulomb"
    finding = ("Dry friction acts on {joints}",)
    change = ("Dry friction on {joints} has {increased}",)
    formula = "f_c·sgn(q̇)"
    coefficients = (
        Coefficient("f_c", "N·m", meaning="dry friction in sliding", opposes_motion=True),
    )
    signals = ("sign",)
    revealed_by = "motion in both directions through the same positions, at low and medium speed"
    confused_with = {
        "viscous": "at one speed the two are the same; use speeds that differ by a factor of 5",
        "load_friction": "under a constant load the two are the same; vary pose and payload",
        "presliding": "differs only within a few degrees after a reversal; reverse slowly",
        "stribeck": "at one low speed the two are the same; use several low speeds",
    }
    typical = "1 to 10 % of the joint's torque limit with harmonic drives; less with torque sensors"
    references = (
        "Luo et al., Robotica 2024, Eq. 10",
        "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
    )

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        return [s.sign]
