"""Forward simulation of a fit."""

from lieid_casadi.simulation.integration import Batch
from lieid_casadi.simulation.polish import polish
from lieid_casadi.simulation.simulate import Simulation, simulate

__all__ = ["Batch", "Simulation", "polish", "simulate"]
