"""Forward simulation of a fit, and its exact torque for MuJoCo."""

from lieid_casadi.simulation.batch import simulate_batch
from lieid_casadi.simulation.mujoco_callback import mujoco_callback
from lieid_casadi.simulation.polish import polish
from lieid_casadi.simulation.simulate import Simulation, WindowDrift, simulate, window_drift

__all__ = [
    "Simulation", "WindowDrift", "mujoco_callback", "polish", "simulate", "simulate_batch",
    "window_drift",
]  # fmt: skip
