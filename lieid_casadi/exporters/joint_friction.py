"""What simulators know of a joint beside its inertia: armature, damping, dry friction."""

from __future__ import annotations

from dataclasses import dataclass

from lieid_casadi.identification.fit import Fit

# effect coefficients that simulators have a place for
PLACES = {"armature.I_a": "armature", "viscous.f_v": "damping", "coulomb.f_c": "friction"}


@dataclass(frozen=True)
class JointFriction:
    """One joint's numbers; None where the model lacks the effect.

    Armature in kg·m², damping in N·m·s/rad, friction in N·m (sliding joints: kg, N·s/m, N).
    """

    armature: float | None = None
    damping: float | None = None
    friction: float | None = None


def joint_frictions(fit: Fit) -> tuple[JointFriction, ...]:
    """Return what the fit says per joint; negative values, which no simulator takes, are 0."""
    found: list[dict[str, float]] = [{} for _ in range(fit.model.n)]
    for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True):
        place = PLACES.get(column.name)
        if place is not None:
            found[column.joint][place] = max(float(value), 0.0)
    return tuple(JointFriction(**numbers) for numbers in found)


def left_out(fit: Fit, places: set[str]) -> list[str]:
    """Return the names of effects that have none of the given places."""
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
