"""Properties of joints in simulators: armature, damping, dry friction."""

from __future__ import annotations

from dataclasses import dataclass

from lieid_casadi.identification.fit import Fit

# coefficients that simulators have an attribute for
PLACES = {"armature.I_a": "armature", "viscous.f_v": "damping", "coulomb.f_c": "friction"}


@dataclass(frozen=True)
class SimulatorJoint:
    """Properties of one joint; None if the model does not have the effect.

    Armature in kg·m², damping in N·m·s/rad, friction in N·m (sliding joints: kg, N·s/m, N).
    """

    armature: float | None = None
    damping: float | None = None
    friction: float | None = None


def simulator_joints(fit: Fit) -> tuple[SimulatorJoint, ...]:
    """Return the properties of each joint; negative values, which simulators refuse, become 0."""
    found: list[dict[str, float]] = [{} for _ in range(fit.model.n)]
    for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True):
        place = PLACES.get(column.name)
        if place is not None:
            found[column.joint][place] = max(float(value), 0.0)
    return tuple(SimulatorJoint(**numbers) for numbers in found)


def left_out(fit: Fit, places: set[str]) -> list[str]:
    """Return the names of effects that have none of the given attributes."""
    names = []
    for column in fit.model.columns:
        effect = column.name.rpartition(".")[0]
        if PLACES.get(column.name) not in places and effect not in names:
            names.append(effect)
    return names


def negative(fit: Fit) -> list[str]:
    """Return the labels of coefficients that were set to 0 because they are negative."""
    return [
        column.label
        for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True)
        if column.name in PLACES and value < 0.0
    ]
