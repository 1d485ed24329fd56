"""The model that a design evaluates: the effects whose columns follow from the motion."""

from __future__ import annotations

from lieid_casadi.effects import Effect, Placement, place
from lieid_casadi.effects.arm_effect import ArmEffect
from lieid_casadi.errors import NotCountedWarning
from lieid_casadi.model import Model


def design_model(model: Model) -> tuple[Model, tuple[NotCountedWarning, ...]]:
    """Return the model whose regressor a design evaluates, and a warning for what differs.

    Presliding is replaced by the dry friction that it becomes in sliding, and friction that falls
    with temperature by viscous friction at one temperature. Left out are effects of a measured
    temperature, which no trajectory chooses, other effects with memory, and effects on the whole
    arm or on the measurement.
    """
    model.robot.require_numbers("excite")
    kept: list[Placement] = []
    left_out: list[Placement] = []
    replaced: list[Placement] = []
    for placement in model.placements:
        others = placement.effect.counted_as
        if others:
            replaced.append(placement)
            kept += [new for name in others for new in place(name, model.n, [placement.joint])]
        elif follows_from_motion(placement.effect):
            kept.append(placement)
        else:
            left_out.append(placement)
    unique = {placement.label: placement for placement in kept}
    warnings = []
    if replaced:
        names = ", ".join(p.label for p in replaced)
        dry = sorted({name for p in replaced for name in p.effect.counted_as})
        warnings.append(
            NotCountedWarning(
                f"{names}: replaced by {' and '.join(dry)} in the regressor of the design"
            )
        )
    if left_out:
        names = ", ".join(p.label for p in left_out)
        warnings.append(
            NotCountedWarning(
                f"{names}: not in the regressor of the design, because the columns need "
                "temperature, memory, the whole arm or the measurement. Except for temperature, "
                "lieid discriminate designs a motion that separates them from other effects"
            )
        )
    return Model.of_placements(model.robot, tuple(unique.values())), tuple(warnings)


def follows_from_motion(effect: Effect) -> bool:
    """Return whether an effect's columns follow from the motion and the time of one instant."""
    has_memory = isinstance(effect, ArmEffect) or bool(effect.states)
    return not has_memory and "temperature" not in effect.signals and not effect.commanded
