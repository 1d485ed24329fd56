"""Torque on a joint from the motion of another: shared gears, coupled drives."""

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class TransmissionCoupling(Effect):
    """Viscous and dry friction on joint i from the motion of joint j, written ``:i<j``.

    τ_i = f_v·q̇_j + f_c·sgn(q̇_j), with f_v in N·m·s/rad and f_c in N·m.
    """

    name = "transmission_coupling"
    finding = ("The motion of joint {source} causes friction on {joints}",)
    change = ("Friction on {joints} from the motion of joint {source} has changed",)
    options = {
        "rotor": (
            "joint i also accelerates the rotor of joint j's drive, as where the gears of a wrist "
            "turn each other; 5<6 and 6<5 have the same inertia"
        )
    }
    signals: tuple[str, ...] = ("dq", "sign")
    couples = True
    revealed_by = "motion in which the two joints move one at a time"
    confused_with = {
        "viscous": "similar where both joints move together; move them one at a time",
        "coulomb": "similar where both joints move together; move them one at a time",
    }
    typical = "up to the size of the joint's own friction in coupled wrists; zero elsewhere"
    references = ("Gautier, Janot, Vandanjon, IEEE Trans. Control Syst. Technol. 21(2), 2013",)

    def __init__(self, *, option: str = "") -> None:
        super().__init__(option=option)
        self.formula = "f_v·q̇_j + f_c·sgn(q̇_j)"
        self.coefficients = (
            Coefficient("f_v", "N·m·s/rad", meaning="friction per velocity of joint j"),
            Coefficient("f_c", "N·m", meaning="dry friction from the motion of joint j"),
        )
        if option == "rotor":
            self.formula += " + I_a·q̈_j"
            self.coefficients += (Coefficient("I_a", "kg·m²", meaning="shared rotor inertia"),)
            self.signals = ("dq", "ddq", "sign")

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        assert s.other is not None  # placed on a pair of joints
        friction = [s.other.dq, s.other.sign]
        return [*friction, s.other.ddq] if self.option == "rotor" else friction
