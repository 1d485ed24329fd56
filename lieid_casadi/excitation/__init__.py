"""Optimal excitation: trajectories that identify the parameters best, within stated limits."""

from lieid_casadi.excitation.checks import default_limits
from lieid_casadi.excitation.clearance import (
    Obstacle,
    SelfCollision,
    Wall,
    floor,
    workspace_box,
)
from lieid_casadi.excitation.criteria import Criterion
from lieid_casadi.excitation.excite import Excitation, excite
from lieid_casadi.excitation.friction_sweep import FrictionSweep, friction_sweep
from lieid_casadi.excitation.limits import (
    CartesianSpeed,
    ConstraintSet,
    ExpressionLimit,
    Limit,
    Symbols,
    jerk_limit,
)
from lieid_casadi.excitation.links import Capsule, capsules_of, enclosing, load_capsules, skeleton
from lieid_casadi.excitation.torque_limit import Torque
from lieid_casadi.excitation.trajectory import Basis, BSpline, Fourier, ModifiedFourier

__all__ = [
    "BSpline",
    "Basis",
    "Capsule",
    "CartesianSpeed",
    "ConstraintSet",
    "Criterion",
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
