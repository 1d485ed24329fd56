"""Runs of simulated arms with and without a payload of known parameters."""

from functools import lru_cache

import numpy as np
from plant.recordings import recorded

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
def measured(arm, *, motion=4, seed=0, seconds=30.0, **options):
    """A recording of an arm on a random motion that it tracks perfectly."""
    return recorded(arm, motion, seconds=seconds, step=0.001, seed=seed, harmonics=8, **options)


def fitted(arm, effects="coulomb,viscous,offset", **run):
    """A fit of an arm without payload."""
    model = lieid.Model(arm.robot, effects)
    return lieid.identify(model, measured(arm, **run), processing=CUTOFF)
