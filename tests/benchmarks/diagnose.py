"""Processor time of a whole diagnosis, compared with one refit for every candidate.

    python tests/benchmarks/diagnose.py [--samples 3000 100000] [--ur10e]

The peer stacks the model's filtered columns and one candidate's and calls ``numpy.linalg.lstsq``,
candidate after candidate, at one value of its shape parameters: a scan without evidence, without
shapes, rivals or a second step. ``--ur10e`` diagnoses 30 s and 50 s of a real UR10e instead, among
recordings that ``LIEID_RECORDINGS`` names (see tests/real_arms.py).

Processor time is longer on a machine with other work, which shares its caches.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from real_arms import UR10E

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis import DiagnosisOptions
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.identification.default_effects import default_effects
from lieid_casadi.recording import process

ROBOT = lieid.robots.panda()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")


def recording(arm, samples, seed):
    trajectory = plant.FourierTrajectory(ROBOT, base_frequency=0.05, seed=seed)
    rate = 100.0 if samples < 10_000 else 1000.0
    t = np.arange(samples) / rate
    sensors = replace(plant.demo_sensors(ROBOT), rate=rate)
    return plant.measure_along(arm, t, *trajectory.at(t), sensors=sensors, seed=seed)


def timed(run):
    wall, processor = time.perf_counter(), time.process_time()
    result = run()
    return result, time.perf_counter() - wall, time.process_time() - processor


def refits(train):
    """Refit once for every candidate; return how many there were."""
    fit = lieid.identify(MODEL, train)
    context = ScreeningContext.of(fit, process(train, fit.processing), DiagnosisOptions())
    torque, own = np.concatenate(context.torque), np.concatenate(context.model_columns)
    seen = set()
    for group, candidate in enumerate(context.candidates.owner_index):
        if candidate not in seen:
            seen.add(candidate)
            columns = np.hstack([own, context.candidates.stacked(group)])
            np.linalg.lstsq(columns, torque, rcond=None)
    return len(seen)


def ur10e():
    """Diagnose the training recordings of a real arm whose torque is that of motor currents."""
    robot = lieid.Robot.load(UR10E / "ur10e.urdf")
    files = ("excitation_30s.csv.gz", "excitation_50s.csv.gz")
    train = [lieid.Recording.load(UR10E / file) for file in files]
    model = lieid.Model(robot, default_effects(robot, train, motor_side=True).names)
    found, wall, processor = timed(lambda: lieid.diagnose(model, train))
    steps = ", ".join(step.label for step in found.steps)
    sys.stdout.write(
        f"UR10e, 30 s + 50 s: {wall:.1f} s ({processor:.1f} s of processor time), "
        f"{found.verdict}: {steps}\n"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, nargs="+", default=[3000])
    parser.add_argument("--ur10e", action="store_true", help="a real arm instead")
    args = parser.parse_args()
    if args.ur10e:
        ur10e()
        return
    arm = plant.demo_arm(ROBOT, seed=1)
    for samples in args.samples:
        train, test = (recording(arm, samples, seed) for seed in (2, 3))
        found, wall, processor = timed(lambda a=train, b=test: lieid.diagnose(MODEL, a, b))
        count, peer_wall, peer = timed(lambda a=train: refits([a]))
        steps = ", ".join(step.label for step in found.steps) or "nothing"
        sys.stdout.write(
            f"2 x {samples} samples, 7 joints: {wall:.1f} s ({processor:.1f} s of processor time), "
            f"{found.verdict}: {steps}; refitting once for each of {count} candidates "
            f"{peer_wall:.1f} s ({peer:.1f} s): ratio {processor / peer:.2f}\n"
        )
        before = lieid.identify(MODEL, train)
        since, wall, processor = timed(lambda f=before, b=test: lieid.diagnose(f, b))
        sys.stdout.write(f"  since a fit: {wall:.1f} s ({processor:.1f} s), {since.verdict}\n")


if __name__ == "__main__":
    main()
