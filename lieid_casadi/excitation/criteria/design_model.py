"""What a trajectory can excite of a model: the effects that count in a design."""

from __future__ import annotations

from lieid_casadi.effects import Effect, Placement, place
from lieid_casadi.effects.arm_effect import ArmEffect
from lieid_casadi.errors import NotCountedWarning
from lieid_casadi.model import Model

#: Effects that a design sees as others: what they come to in sliding, and at one temperature.
COUNTED_AS = {
    "presliding": ("coulomb",),
    "presliding/load": ("coulomb", "load_friction"),
    "presliding/square": ("coulomb",),
    "presliding/lugre": ("coulomb",),
    "temperature_friction/exponential": ("viscous",),
}


def seen_by_design(model: Model) -> tuple[Model, tuple[NotCountedWarning, ...]]:
    """Return the model whose regressor counts, and what of the given one does not.

    Presliding counts as the dry friction that it comes to in sliding; friction that falls with
    warmth as viscous friction at one temperature. Left out are effects of a measured temperature,
    which no trajectory chooses, other effects with memory, and those on the whole arm or on the
    measurement.
    """
    kept: list[Placement] = []
    left_out: list[Placement] = []
    replaced: list[Placement] = []
    for placement in model.placements:
        others = COUNTED_AS.get(placement.effect.label)
        if others is not None:
            replaced.append(placement)
            kept += [new for name in others for new in place(name, model.n, [placement.joint])]
        elif counts(placement.effect):
            kept.append(placement)
        else:
            left_out.append(placement)
    unique = {placement.label: placement for placement in kept}
    warnings = []
    if replaced:
        names = ", ".join(p.label for p in replaced)
        told = sorted({name for p in replaced for name in COUNTED_AS[p.effect.label]})
        warnings.append(
            NotCountedWarning(f"{names}: counted in the regressor as {' and '.join(told)}")
        )
    if left_out:
        names = ", ".join(p.label for p in left_out)
        warnings.append(
            NotCountedWarning(
                f"{names}: not in the regressor that counts, because temperature, memory, the "
                "whole arm or the measurement is needed; but for temperature, lieid discriminate "
                "designs a motion that tells them from the rest"
            )
        )
    return Model.of_placements(model.robot, tuple(unique.values())), tuple(warnings)


def counts(effect: Effect) -> bool:
    """Whether an effect's columns follow from the motion and the time of one instant."""
    remembers = isinstance(effect, ArmEffect) or bool(effect.states)
    return not remembers and "temperature" not in effect.signals
