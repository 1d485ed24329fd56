"""Forward simulation of a fit, and its exact torque for MuJoCo."""

from lieid_casadi.simulation.mujoco_callback import mujoco_callback
from lieid_casadi.simulation.simulate import Simulation, WindowDrift, simulate, window_drift

__all__ = ["Simulation", "WindowDrift", "mujoco_callback", "simulate", "window_drift"]
