"""Coverage of 90 % ensembles on simulated 6- and 7-joint arms.

    python tests/benchmarks/ensemble_coverage.py [--arms 6]

For each arm: fit of method `feasible` to one recording, 60 samples, a held-out motion. `measured`
is the share of the measured torque in motion within the 90 % bands of samples and residual;
`true` the share of the torque without noise within the 5 to 95 % quantiles of the samples. With
`--hidden EFFECT` the arms have an effect that the model lacks.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hidden_effects.arms import load_arm

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.identification.ensemble import ensemble_coverage

EFFECTS = "coulomb,viscous,offset"


def recorded(arm, seed, duration, sensors):
    motion = plant.FourierTrajectory(arm.robot, base_frequency=0.05, seed=seed)
    t = np.arange(0.0, duration, 0.002)
    return plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed)


def shares(robot, number, hidden):
    """Return shares (n,) of measured and of true torque, and joints where the model errs."""
    arm = plant.demo_arm(robot, hidden=hidden, joint=1, seed=number)
    sensors = plant.demo_sensors(robot, rate=200.0)
    train = recorded(arm, 100 + number, 20.0, sensors)
    fit = lieid.identify(lieid.Model(robot, EFFECTS), train, method="feasible")
    samples = fit.sample(60, seed=number)
    found = ensemble_coverage(samples, recorded(arm, 200 + number, 20.0, sensors))
    exact = recorded(arm, 200 + number, 20.0, plant.Sensors(rate=200.0))
    torque = np.array([sample.predict(exact) for sample in samples])
    low, high = np.percentile(torque, [5.0, 95.0], axis=0)
    inside = np.where(np.abs(exact.dq) > 0.05, (exact.tau >= low) & (exact.tau <= high), np.nan)
    return found.share, np.nanmean(inside, axis=0), found.too_narrow


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=6, help="of each robot")
    parser.add_argument("--hidden", help="effect of joint 2 that the model lacks")
    args = parser.parse_args()
    for name in ("ur10e", "panda"):
        rows = []
        began = time.process_time()
        for number in range(args.arms):
            rows.append(shares(load_arm(name), number, args.hidden))
            sys.stderr.write(f"{name} {number}: {rows[-1]}\n")
        measured, true, narrow = (np.array(each) for each in zip(*rows, strict=True))
        spread = true.mean(axis=1).std(ddof=1) / np.sqrt(len(true)) if len(true) > 1 else np.nan
        sys.stdout.write(
            f"{name}: measured {measured.mean():.3f} (joints of all arms {measured.min():.3f} to "
            f"{measured.max():.3f}), true {true.mean():.3f} ± {spread:.3f}, "
            f"said too narrow: {narrow.any(axis=0).nonzero()[0] + 1}, "
            f"{time.process_time() - began:.0f} s\n"
        )
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
