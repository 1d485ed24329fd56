"""Optimal excitation: trajectories that identify the parameters best, within stated limits."""

from lieid_casadi.excitation.checks import default_limits
from lieid_casadi.excitation.clearance import Obstacle, SelfCollision, Wall, floor, workspace_box
from lieid_casadi.excitation.criteria import Criterion
from lieid_casadi.excitation.excite import Excitation, excite
from lieid_casadi.excitation.friction_sweep import FrictionSweep, friction_sweep
from lieid_casadi.excitation.limits import CartesianSpeed, ConstraintSet, Limit, SymbolicSet, Torque
from lieid_casadi.excitation.links import Capsule, capsules_of, enclosing, load_capsules, skeleton
from lieid_casadi.excitation.trajectory import Fourier

__all__ = [
    "Capsule", "CartesianSpeed", "ConstraintSet", "Criterion", "Excitation", "Fourier",
    "FrictionSweep", "Limit", "Obstacle", "SelfCollision", "SymbolicSet", "Torque", "Wall",
    "capsules_of", "default_limits", "enclosing", "excite", "floor", "friction_sweep",
    "load_capsules", "skeleton", "workspace_box",
]  # fmt: skip
