"""Forward simulation of a fit."""

from lieid_casadi.simulation.integration import simulate_batch
from lieid_casadi.simulation.polish import polish
from lieid_casadi.simulation.simulate import Simulation, simulate

__all__ = ["Simulation", "polish", "simulate", "simulate_batch"]
