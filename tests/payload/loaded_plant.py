"""Runs of simulated arms with and without a payload of known parameters."""

from functools import lru_cache

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

MASS, COM, RADIUS = 2.0, (0.03, -0.02, 0.08), 0.06
PAYLOAD = plant.Payload(mass=MASS, com=COM, radius=RADIUS)
MOMENT = 0.4 * MASS * RADIUS**2
#: mass, centre of mass, inertia about it
TRUTH = np.array([MASS, *COM, MOMENT, 0, MOMENT, 0, 0, MOMENT])
CUTOFF = lieid.Processing(cutoff=8.0)
PANDA = lieid.robots.panda()


@lru_cache(maxsize=16)
def measured(arm, *, motion=4, seed=0, seconds=30.0, sensors=None, name="", motion_robot=None):
    """A recording of an arm on a random motion that it tracks perfectly."""
    path = plant.FourierTrajectory(
        motion_robot or arm.robot, base_frequency=1 / seconds, harmonics=8, seed=motion
    )
    t = np.arange(0.0, seconds, 0.001)
    quality = sensors or plant.demo_sensors(arm.robot)
    return plant.measure_along(arm, t, *path.at(t), sensors=quality, seed=seed, name=name)


def fitted(arm, effects="coulomb,viscous,offset", **run):
    """A fit of an arm without payload."""
    model = lieid.Model(arm.robot, effects)
    return lieid.identify(model, measured(arm, **run), processing=CUTOFF)
