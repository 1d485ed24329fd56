"""Recordings of simulated arms along Fourier series, with the sensors of the demonstration."""

import numpy as np

from lieid_casadi import plant


def recorded(arm, motion, *, seconds=10.0, step=0.002, sensors=None, seed=None, name="", **series):
    """Measure an arm along the series of seed ``motion``, whose period is the whole recording."""
    path = plant.FourierTrajectory(
        arm.robot, seed=motion, **{"base_frequency": 1.0 / seconds} | series
    )
    t = np.arange(0.0, seconds, step)
    return plant.measure_along(
        arm, t, *path.at(t), sensors=sensors or plant.demo_sensors(arm.robot),
        seed=motion if seed is None else seed, name=name,
    )  # fmt: skip
