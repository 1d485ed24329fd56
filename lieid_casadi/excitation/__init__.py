"""Optimal excitation: trajectories that identify the parameters best, within stated limits."""

from lieid_casadi.excitation.basis.families import Basis, BSpline, Fourier, ModifiedFourier
from lieid_casadi.excitation.excitation import Excitation
from lieid_casadi.excitation.excite import excite
from lieid_casadi.excitation.friction_sweep import FrictionSweep, friction_sweep
from lieid_casadi.excitation.limits.capsules import Capsule, enclosing, skeleton
from lieid_casadi.excitation.limits.constraint_sets import ConstraintSet
from lieid_casadi.excitation.limits.default_limits import default_limits
from lieid_casadi.excitation.limits.expression_limit import (
    ExpressionLimit,
    Symbols,
    jerk_limit,
)
from lieid_casadi.excitation.limits.link_geometry import capsules_of, load_capsules
from lieid_casadi.excitation.limits.self_collision import SelfCollision
from lieid_casadi.excitation.limits.symbolic_limits import CartesianSpeed, Limit
from lieid_casadi.excitation.limits.torque_limit import Torque
from lieid_casadi.excitation.limits.workspace import (
    Obstacle,
    Wall,
    floor,
    workspace_box,
)

__all__ = [
    "BSpline",
    "Basis",
    "Capsule",
    "CartesianSpeed",
    "ConstraintSet",
    "Excitation",
    "ExpressionLimit",
    "Fourier",
    "FrictionSweep",
    "Limit",
    "ModifiedFourier",
    "Obstacle",
    "SelfCollision",
    "Symbols",
    "Torque",
    "Wall",
    "capsules_of",
    "default_limits",
    "enclosing",
    "excite",
    "floor",
    "friction_sweep",
    "jerk_limit",
    "load_capsules",
    "skeleton",
    "workspace_box",
]
