"""Recordings of a simulated arm under position control, with its torque hidden."""

from dataclasses import replace

import numpy as np
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.robot.drive import Drive


def commanded(recording, drives):
    """Return a recording whose torque is replaced by the commands of laws that ask for it."""
    error = np.column_stack(
        [
            (recording.tau[:, j] + law.damping * recording.dq[:, j]) / law.stiffness
            for j, law in enumerate(drives)
        ]
    )
    return replace(recording, tau=None, command=recording.q + error)


def measured(robot, *, hidden=None, seed=0, seconds=20.0, motion=1, payload=None):
    """Return a recording of the plant with torque, on a random motion."""
    arm = plant.demo_arm(robot, seed=1, hidden=hidden)
    arm = arm if payload is None else arm.with_effects(payload)
    run = recorded(arm, motion, seconds=seconds, seed=seed, harmonics=8)
    return lieid.Recording.from_arrays(run.t, run.q, run.dq, run.tau, name="run.csv")


TWO_LINK = lieid.robots.two_link()
LAWS = [Drive(stiffness=120.0, damping=2.0), Drive(stiffness=50.0, damping=0.5)]
