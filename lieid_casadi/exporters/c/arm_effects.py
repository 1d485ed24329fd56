"""Effects on the whole arm or on the measurement in exported C, which evaluates one instant."""

from __future__ import annotations

import casadi as ca

from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import ExportError
from lieid_casadi.expressions.torque import ArmInstant
from lieid_casadi.identification.fit import Fit
from lieid_casadi.model import Model


def with_arm_effects(columns: ca.SX, model: Model, arm: ArmInstant, values: ca.SX) -> ca.SX:
    """Return the effect columns (n, m) with those of effects on the whole arm filled in.

    ``columns`` (n, m): effect columns; those of effects on the whole arm are replaced; ``arm``: the
    arm at the instant; ``values`` (m,): coefficients, at which these effects are linearized.
    Raises `ExportError`: an effect needs more than one instant.
    """
    first = 0
    for p in model.placements:
        last = first + len(p.effect.coefficients)
        if isinstance(p.effect, ArmEffect):
            now = p.effect.instant_columns(arm, p.joint, values[first:last])
            if now is None:
                raise ExportError(
                    f"{p.label} needs the motion over time, and exported C has one instant; "
                    "expected a fit without this effect"
                )
            columns[:, first:last] = now
        first = last
    return columns


def arm_notes(fit: Fit) -> list[str]:
    """Return notes for users of the code on such effects."""
    placed = [p for p in fit.model.placements if isinstance(p.effect, ArmEffect)]
    texts = {p.label: p.effect.export_note for p in placed if isinstance(p.effect, ArmEffect)}
    notes = [f"{label}: {text}" for label, text in texts.items() if text]
    inside = [label for label, text in texts.items() if not text]
    if inside:
        notes.append(
            f"{', '.join(inside)}: part of the effects; rigid_torque, gravity and mass_matrix do "
            "not include them"
        )
    return notes
