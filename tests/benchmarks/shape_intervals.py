"""Coverage of the 95 % intervals of shape parameters, with torque noise correlated over 0.3 s.

    python tests/benchmarks/shape_intervals.py [RUNS]

One arm is measured RUNS times (40 if left out, two minutes) with different noise, for each of three
effects. Prints the part of the intervals that contain the true value, and of value ± 1.96 std as
the covariance alone would give it.
"""

import sys
from dataclasses import replace

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.recording import Processing

ROBOT = lieid.robots.two_link()
CORRELATION = 0.3  # s
DURATION, RATE = 30.0, 100.0
CUTOFF = 6.0  # Hz

#: Effect → its shape's true value, and the torque on joint 2 per unit of noise.
HIDDEN = {
    "stribeck": (0.12, lambda q, dq: 0.6 * np.sign(dq) * np.exp(-((dq / 0.12) ** 2))),
    "torque_ripple": (9.0, lambda q, dq: 0.12 * np.sin(9.0 * q + 0.3)),
    "position_friction": (2.5, lambda q, dq: 0.1 * np.sign(dq) * np.cos(2.5 * q)),
}


def fits(effect, runs, *, noise=0.1, seed=0):
    """Return the fit of each run with a further effect on joint 2."""
    friction = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.zeros(2))
    arm = plant.Arm(ROBOT, ROBOT.link_parameters, friction)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=1 / DURATION, seed=3)
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    sensors = plant.Sensors(rate=RATE, coloured_noise=noise, correlation_time=CORRELATION)
    model = lieid.Model(ROBOT, f"coulomb,viscous,offset,{effect}:2")
    for run in range(runs):
        measured = plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed + run)
        tau = measured.tau.copy()
        tau[:, 1] += HIDDEN[effect][1](measured.q[:, 1], measured.dq[:, 1])
        recording = replace(measured, tau=tau)
        yield lieid.identify(model, recording, processing=Processing(cutoff=CUTOFF))


def coverage(effect, runs, **options):
    """Return how often the interval, and value ± 1.96 std of the covariance, hold the truth."""
    truth, held = HIDDEN[effect][0], []
    for fit in fits(effect, runs, **options):
        (low, high), std = fit.shape_intervals[0], np.sqrt(fit.covariance[-1, -1])
        held.append((low <= truth <= high, abs(fit.shapes[0] - truth) <= 1.96 * std))
    return np.mean(held, axis=0)


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    for name in HIDDEN:
        interval, plain = coverage(name, count)
        sys.stdout.write(f"{name}: {interval:.1%} (covariance alone {plain:.1%}) of {count}\n")
        sys.stdout.flush()
