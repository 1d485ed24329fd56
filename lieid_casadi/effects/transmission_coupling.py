"""What another joint's motion does to a joint: shared gears, coupled drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Signals, register
from lieid_casadi.errors import EffectError


class TransmissionCoupling(Effect):
    """Viscous and dry friction that joint j's motion makes on joint i.

    Option ``rotor``: joint i also accelerates the rotor of joint j's drive, as where the gears
    of a wrist turn each other. Seen from both joints, 5<6 and 6<5, that inertia is the same.
    """

    name = "transmission_coupling"
    signals: tuple[str, ...] = ("dq", "sign")
    couples = True

    def __init__(self, *, option: str = "") -> None:
        self.option = option
        self.formula = "f_v·q̇_j + f_c·sgn(q̇_j)"
        self.coefficients = (Coefficient("f_v", "N·m·s/rad"), Coefficient("f_c", "N·m"))
        if option == "rotor":
            self.formula += " + I_a·q̈_j"
            self.coefficients += (Coefficient("I_a", "kg·m²"),)
            self.signals = ("dq", "ddq", "sign")
        elif option:
            raise EffectError(f"transmission_coupling has no option {option!r}; expected rotor")

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        assert s.other is not None  # placed on a pair of joints
        friction = [s.other.dq, s.other.sign]
        return [*friction, s.other.ddq] if self.option == "rotor" else friction


register(TransmissionCoupling, options=["rotor"])
