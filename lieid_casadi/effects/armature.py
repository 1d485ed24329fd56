"""Inertia of the rotor and gear, reflected to the joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect
from lieid_casadi.effects.registry import register
from lieid_casadi.effects.signals import Signals


@register
class Armature(Effect):
    """Reflected rotor inertia: τ = I_a·q̈, I_a in kg·m² and not negative.

    Revealed by motion with large accelerations at several loads. Confused with the rotational
    inertia of the links about the same axis, above all on the first joints.
    """

    name = "armature"
    finding: ClassVar = ("Rotor inertia acts on {joints}",)
    change: ClassVar = (
        "Rotor inertia on {joints} has increased",
        "Rotor inertia on {joints} has decreased",
    )
    formula = "I_a·q̈"
    coefficients = (
        Coefficient(
            "I_a", "kg·m²", lower=0.0, limit=100.0, meaning="rotor inertia times gear ratio squared"
        ),
    )
    signals = ("ddq",)
    energy = "armature"
    revealed_by = "large accelerations in poses with different link inertia about the joint axis"
    confused_with: ClassVar = {
        "torque_delay": "a delay adds a term in the derivative of the torque; vary the frequency",
        "joint_elasticity": "both grow with acceleration; elasticity also moves other joints",
    }
    typical = "0.05 to 5 kg·m² at geared joints of arms of 5 to 100 kg"
    references = ("Siciliano, Sciavicco, Villani, Oriolo, Robotics, 2009, ch. 7",)

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return the columns of the formula."""
        return [s.ddq]
