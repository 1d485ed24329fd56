"""Processor time of a diagnosis, in seconds and in multiples of an identification.

    python tests/benchmarks/diagnose.py [--samples 3000 100000]

The arm is a simulated one of seven joints with two recordings of this many samples. The time of
real recordings is in the table of ``real_arms.py``. Processor time is longer on a machine with
other work, which shares its caches; the ratio, of the same run, is more reliable.
"""

import argparse
import sys
import time
from dataclasses import replace

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

ROBOT = lieid.robots.panda()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")


def recording(arm, samples, seed):
    trajectory = plant.FourierTrajectory(ROBOT, base_frequency=0.05, seed=seed)
    rate = 100.0 if samples < 10_000 else 1000.0
    t = np.arange(samples) / rate
    sensors = replace(plant.demo_sensors(ROBOT), rate=rate)
    period = np.mod(t, trajectory.duration)
    return plant.measure_along(arm, t, *trajectory.at(period), sensors=sensors, seed=seed)


def timed(function):
    start = time.process_time()
    result = function()
    return result, time.process_time() - start


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--samples", nargs="+", type=int, default=[3000, 100_000])
    args = parser.parse_args()
    for samples in args.samples:
        arm = plant.demo_arm(ROBOT, hidden="load_friction", joint=1)
        train, test = (recording(arm, samples, seed) for seed in (1, 2))
        lieid.identify(MODEL, train)  # compiled code is generated once
        _, least = timed(lambda train=train: lieid.identify(MODEL, train))
        found, seconds = timed(lambda train=train, test=test: lieid.diagnose(MODEL, train, test))
        steps = ", ".join(step.label for step in found.steps) or found.verdict
        sys.stdout.write(
            f"2 x {samples} samples: {seconds:.1f} s, {seconds / least:.0f} times an "
            f"identification of the plain model ({steps})\n"
        )


if __name__ == "__main__":
    main()
