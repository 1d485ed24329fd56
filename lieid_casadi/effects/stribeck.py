"""Stribeck friction: more friction at low speed (Luo et al. 2024, Eqs. 6-7)."""

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, Shape, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register

REGULARIZATION = 1e-6  # added to (q̇/v_s)²: a power below 2 has no derivative at rest otherwise


@register
class Stribeck(Effect):
    """Excess of static over Coulomb friction, which decreases with speed; beside `coulomb`.

    τ = (f_s − f_c)·sgn(q̇)·e^{−(q̇/v_s)²}, with f_s − f_c in N·m and v_s in rad/s. Revealed by slow
    motion at several speeds below v_s.
    """

    name = "stribeck"
    finding = (
        "Friction on {joints} falls with speed from standstill",
        "Friction on {joints} rises with speed from standstill",
    )
    change = ("Friction on {joints} near standstill has {increased}",)
    options = {
        "exponent": "Eq. 6 with its exponent δ_s free; it is 2 otherwise",
        "two_width": (
            "Eq. 7: Coulomb friction rises as static friction falls, each with its own width; "
            "replaces coulomb"
        ),
    }
    signals: tuple[str, ...] = ("dq", "sign")
    like_uncertain_friction = ("rest",)
    revealed_by = "reversals and constant speeds between the dead zone and a few times v_s"
    confused_with = {
        "coulomb": "similar where no speed is below v_s; move more slowly",
        "presliding": "both act near reversals; only presliding depends on the distance moved",
        "viscous_polynomial": "both change friction over speed; use speeds below v_s",
    }
    typical = "f_s − f_c of 10 to 50 % of f_c; v_s of 0.01 to 0.3 rad/s"
    references = (
        "Luo et al., Robotica 2024, Eqs. 6-7",
        "Tustin, J. IEE 94, 1947",
        "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
    )

    def __init__(self, *, option: str = "") -> None:
        super().__init__(option=option)
        width = Shape(
            "v_s", "rad/s", 0.1, 1e-3, 2.0, meaning="Stribeck velocity", resolved_by="speed"
        )
        self.coefficients = (
            Coefficient(
                "f_s-f_c", "N·m", meaning="static minus Coulomb friction", opposes_motion=True
            ),
        )
        self.shapes = (width,)
        self.formula = "(f_s − f_c)·sgn(q̇)·e^{−(q̇/v_s)²}"
        if option == "exponent":
            self.formula = "(f_s − f_c)·sgn(q̇)·e^{−|q̇/v_s|^δ_s}"
            self.shapes += (Shape("delta_s", "1", 2.0, 0.3, 5.0, meaning="exponent"),)
        elif option == "two_width":
            self.formula = "sgn(q̇)·(f_c·(1 − e^{−(q̇/v_c)²}) + f_s·e^{−(q̇/v_s)²})"
            self.replaces = ("coulomb",)
            self.coefficients = (
                Coefficient("f_c", "N·m", meaning="Coulomb friction"),
                Coefficient("f_s", "N·m", meaning="static friction"),
            )
            rise = Shape(
                "v_c", "rad/s", 0.02, 1e-3, 2.0,
                meaning="velocity over which Coulomb friction rises", resolved_by="speed",
            )  # fmt: skip
            self.shapes = (rise, width)

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        ratio = (s.dq / shape["v_s"]) ** 2
        if self.option == "exponent":
            return [s.sign * ca.exp(-((ratio + REGULARIZATION) ** (shape["delta_s"] / 2)))]
        fading = s.sign * ca.exp(-ratio)
        if self.option == "two_width":
            return [-s.sign * ca.expm1(-((s.dq / shape["v_c"]) ** 2)), fading]
        return [fading]
