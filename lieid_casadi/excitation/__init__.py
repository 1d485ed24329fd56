"""Optimal excitation: trajectories that identify the parameters best, within every limit."""

from lieid_casadi.excitation.excitation import Excitation
from lieid_casadi.excitation.excite import excite
from lieid_casadi.excitation.friction_sweep import FrictionSweep, friction_sweep
from lieid_casadi.excitation.limits.capsules import Capsule, enclosing, skeleton
from lieid_casadi.excitation.limits.default_limits import default_limits
from lieid_casadi.excitation.limits.link_geometry import capsules_of, load_capsules
from lieid_casadi.excitation.limits.symbolic_limits import CartesianSpeed, Torque
from lieid_casadi.excitation.limits.workspace import (
    Obstacle,
    SelfCollision,
    Wall,
    floor,
    workspace_box,
)

__all__ = [
    "Capsule",
    "CartesianSpeed",
    "Excitation",
    "FrictionSweep",
    "Obstacle",
    "SelfCollision",
    "Torque",
    "Wall",
    "capsules_of",
    "default_limits",
    "enclosing",
    "excite",
    "floor",
    "friction_sweep",
    "load_capsules",
    "skeleton",
    "workspace_box",
]
