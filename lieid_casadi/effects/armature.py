"""Inertia of the rotor and gear, reflected to the joint."""

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register


@register
class Armature(Effect):
    """Reflected rotor inertia: τ = I_a·q̈, I_a in kg·m² and not negative."""

    name = "armature"
    finding = ("Rotor inertia acts on {joints}",)
    change = ("Rotor inertia on {joints} has {increased}",)
    formula = "I_a·q̈"
    coefficients = (
        Coefficient(
            "I_a", "kg·m²", lower=0.0, limit=100.0, meaning="rotor inertia times gear ratio squared"
        ),
    )
    signals = ("ddq",)
    energy = "armature"
    revealed_by = "large accelerations in poses with different link inertia about the joint axis"
    confused_with = {
        "torque_delay": "a delay adds a term in the derivative of the torque; vary the frequency",
        "joint_elasticity": "both grow with acceleration; elasticity also moves other joints",
    }
    typical = "0.05 to 5 kg·m² at geared joints of arms of 5 to 100 kg"
    references = ("Siciliano, Sciavicco, Villani, Oriolo, Robotics, 2009, ch. 7",)

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        return [s.ddq]
