"""Back-EMF of a drive whose control law does not contain it."""

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class BackEmf(Effect):
    """A motor's voltage loses k_e·q̇: the law's torque exceeds the delivered one by k·q̇.

    k = k_t·k_e/R in N·m·s/rad, at the joint. Of position-controlled drives. Equal to `viscous`
    with any data: a model has one of them; presets of servos contain it.
    """

    name = "back_emf"
    finding = ("The back-EMF of {joints} is not part of the drive law",)
    change = ("The back-EMF of {joints} has {increased}",)
    formula = "k·q̇, k = k_t·k_e/R"
    coefficients = (
        Coefficient("k", "N·m·s/rad", lower=0.0, meaning="torque per speed lost to back-EMF"),
    )
    signals = ("dq",)
    commanded = True
    revealed_by = "motion at several speeds; only a run without power separates it from friction"
    confused_with = {"viscous": "the two are the same with any recording under power"}
    typical = "stall torque over no-load speed of a servo: 0.05 to 1 N·m·s/rad"

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        return [s.dq]
