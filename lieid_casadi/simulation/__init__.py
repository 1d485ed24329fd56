"""Forward simulation of a fit."""

from lieid_casadi.simulation.integration import simulate_batch
from lieid_casadi.simulation.polish import polish
from lieid_casadi.simulation.simulate import MotionGain, Simulation, motion_gain, simulate

__all__ = ["MotionGain", "Simulation", "motion_gain", "polish", "simulate", "simulate_batch"]
