"""A simulated arm as the robot of an experiment, in a function and as a program."""

import sys

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

ROBOT = lieid.robots.two_link()
QUICK = {"longest": 13.0, "rate": 200.0}


def arm(hidden="stribeck", strength=0.5):
    return plant.demo_arm(ROBOT, hidden=hidden, joint=0, strength=strength)


def measured(which, t, q, dq, ddq, seed=1, name=""):
    sensors = plant.demo_sensors(ROBOT, rate=100.0)
    return plant.measure_along(which, t, q, dq, ddq, sensors=sensors, seed=seed, name=name)


def recorder(which):
    """Return a function that measures an arm along each motion, and the motions it was given."""
    motions = []

    def record(motion):
        motions.append(motion)
        s = motion.samples
        return measured(which, s.t, s.q, s.dq, s.ddq, seed=motion.number)

    return record, motions


def sines(which, frequency=0.4, amplitude=0.45):
    """Return a recording along one sine for each joint, which leaves much open."""
    t = np.arange(0.0, 8.0, 0.002)
    w = 2.0 * np.pi * frequency * np.array([1.0, 1.37])
    angle = np.outer(t, w)
    q, dq, ddq = np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)
    centre = np.array([0.6, 0.5])
    return measured(which, t, centre + amplitude * q, amplitude * dq, amplitude * ddq, name="sines")


def main(trajectory, recording):
    with open(trajectory, encoding="utf-8") as file:
        rows = [line for line in file if not line.startswith("#")]
    table = np.genfromtxt(rows, delimiter=",", names=True)
    signals = [
        np.column_stack([table[f"{kind}{j}"] for j in (1, 2)]) for kind in ("q", "dq", "ddq")
    ]
    measured(arm(), table["t"], *signals).save(recording)


if __name__ == "__main__":
    main(*sys.argv[1:])
