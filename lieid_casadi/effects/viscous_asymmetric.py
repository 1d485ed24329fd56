"""Viscous friction that differs between the two directions."""

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class ViscousAsymmetric(Effect):
    """Half the difference of the two directions' viscous coefficients: τ = f·|q̇|.

    f in N·m·s/rad. The asymmetric part of Coulomb friction is the effect `offset`.
    """

    name = "viscous_asymmetric"
    finding = ("Viscous friction on {joints} differs between the directions",)
    change = ("The difference of friction on {joints} between directions has changed",)
    formula = "f·|q̇|"
    coefficients = (
        Coefficient("f", "N·m·s/rad", meaning="half the difference between the directions"),
    )
    signals = ("dq", "sign")
    revealed_by = "fast and slow motion in both directions through the same positions"
    confused_with = {
        "offset": "at one speed the two are the same; use several speeds",
        "viscous_polynomial": "similar where one direction is always faster; use equal speeds",
    }
    typical = "up to 20 % of the viscous coefficient"
    references = ("Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",)

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        return [s.sign * s.dq]
