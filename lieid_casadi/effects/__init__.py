"""Physical effects beside the rigid body: one file each, one definition for every use."""

from lieid_casadi.effects import (
    armature,
    coulomb,
    load_friction,
    offset,
    position_friction,
    presliding,
    sigmoid_friction,
    stribeck,
    temperature_friction,
    transmission_coupling,
    viscous,
    viscous_asymmetric,
    viscous_polynomial,
    warm_up,
)
from lieid_casadi.effects.effect import (
    Coefficient,
    Effect,
    Shape,
    Signals,
    State,
    effect,
    make,
    register,
)
from lieid_casadi.effects.placement import Placement, parse_effects, place

LIBRARY = (
    coulomb.Coulomb,
    viscous.Viscous,
    offset.Offset,
    viscous_polynomial.ViscousPolynomial,
    viscous_asymmetric.ViscousAsymmetric,
    stribeck.Stribeck,
    load_friction.LoadFriction,
    temperature_friction.TemperatureFriction,
    warm_up.WarmUp,
    position_friction.PositionFriction,
    presliding.Presliding,
    sigmoid_friction.SigmoidFriction,
    armature.Armature,
    transmission_coupling.TransmissionCoupling,
)

__all__ = [
    "LIBRARY",
    "Coefficient",
    "Effect",
    "Placement",
    "Shape",
    "Signals",
    "State",
    "effect",
    "make",
    "parse_effects",
    "place",
    "register",
]
