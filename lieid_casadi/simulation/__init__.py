"""Forward simulation of a fit."""

from lieid_casadi.simulation.batch import simulate_batch
from lieid_casadi.simulation.polish import polish
from lieid_casadi.simulation.simulate import (
    MotionGain,
    Simulation,
    WindowDrift,
    motion_gain,
    simulate,
    window_drift,
)

__all__ = [
    "MotionGain", "Simulation", "WindowDrift", "motion_gain", "polish", "simulate",
    "simulate_batch", "window_drift",
]  # fmt: skip
