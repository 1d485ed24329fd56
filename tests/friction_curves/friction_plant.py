"""A simulated two-link arm whose first joint has friction of a known formula."""

from functools import cache

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.excitation import friction_sweep
from lieid_casadi.recording import Processing

ROBOT = lieid.robots.two_link()
CUTOFF = Processing(cutoff=10.0)
SPEEDS = tuple(np.deg2rad([2, 3, 5, 8, 12, 20, 35, 60]))
COULOMB, VISCOUS, EXTRA, WIDTH, LOAD = 1.2, 0.8, 0.7, 0.12, 0.08


def friction(speed, load):
    """Return the friction of the plant at positive speed, N·m."""
    level = COULOMB + EXTRA * np.exp(-((speed / WIDTH) ** 2)) + LOAD * np.abs(load)
    return level + VISCOUS * speed


def arm(*effects, offset=0.0, nominal=False):
    own = plant.JointFriction(
        np.array([COULOMB, 0.4]), np.array([VISCOUS, 0.2]), np.array([offset, 0.0])
    )
    hidden = (plant.Stribeck(0, EXTRA, WIDTH), plant.LoadFriction(0, LOAD), *effects)
    links = ROBOT.link_parameters if nominal else plant.perturbed_inertias(ROBOT, seed=3)
    return plant.Arm(ROBOT, links, own, hidden)


def measured(t, motion, *, hidden=None, torque_noise=0.02, seed=0, rate=250.0, **sensors):
    sensors = plant.Sensors(rate=rate, torque_noise=torque_noise, velocity_noise=1e-4, **sensors)
    return plant.measure_along(hidden or arm(), t, *motion, sensors=sensors, seed=seed, name="run")


@cache
def sweep(hidden=None, *, speeds=SPEEDS, rate=250.0, **options):
    """Measure joint 1 at constant speeds, forward and backward, as `friction_sweep` plans."""
    run = friction_sweep(
        ROBOT, 0, speeds=speeds, seconds=10.0, start_pose=[0.0, 0.4], limits=[], rate=rate
    ).motion
    return measured(run.t, (run.q, run.dq, run.ddq), hidden=hidden, rate=None, **options)


def at_stated_speed(curve):
    """Return which points are at a constant speed, not on a ramp."""
    return np.abs(curve.speed[:, None] / SPEEDS - 1.0).min(axis=1) < 0.01
