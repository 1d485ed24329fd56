"""Friction stage of a 7-joint arm: ``python tests/benchmarks/friction_stage.py``.

A simulated Panda with Stribeck and load-dependent friction sweeps each joint at eight speeds, both
ways across its range, at 125 Hz. Timed, as processor time of one thread: curves by position
matching, then the paper's ten-coefficient model on each. Beside it, on the same curves in the same
run, ``scipy.optimize.least_squares`` on all ten numbers at once with as many starts, which is what
the paper does (Levenberg-Marquardt becomes trust-region, as there are bounds).
"""

import argparse
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

import numpy as np  # noqa: E402
from scipy.optimize import least_squares  # noqa: E402

sys.path.insert(0, str(Path(__file__).parents[2]))

import lieid_casadi as lieid  # noqa: E402
from lieid_casadi import plant  # noqa: E402
from lieid_casadi.friction_curves import fit_friction, friction_curve  # noqa: E402

SPEEDS = tuple(np.deg2rad([2, 3, 5, 8, 12, 20, 35, 55]))
POSE = (0.0, -0.4, 0.3, -1.8, 0.4, 1.8, 0.3)
MODEL = "paper"
EPSILON = 1e-3  # rad/s, of Eq. 8's exponent


def runs(robot):
    """Measure each joint's sweep on the plant."""
    own = plant.JointFriction(np.full(7, 0.8), np.full(7, 0.6), np.zeros(7))
    hidden = [plant.Stribeck(j, 0.5, 0.08) for j in range(7)]
    hidden += [plant.LoadFriction(j, 0.03) for j in range(7)]
    arm = plant.Arm(robot, robot.link_parameters, own, tuple(hidden))
    sensors = plant.Sensors(rate=125.0, torque_noise=0.02, velocity_noise=1e-4)
    for joint in range(7):
        motion = plant.sweep(robot, joint, speeds=SPEEDS, pose=list(POSE))
        t = np.arange(0.0, motion.duration, 0.008)
        yield plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=joint)


def peer(curve, starts):
    """Fit Eq. 8's ten numbers to a curve's points by plain multistart; return its cost."""
    v, load, sigma = curve.speed, np.abs(curve.load), np.maximum(curve.std, 1e-4)

    def residual(x):
        fc, fs, vc, vs, f1, f2, f3, ft, ft1, ft2 = x
        model = fc * -np.expm1(-((v / vc) ** 2)) + fs * np.exp(-((v / vs) ** 2))
        model = model + f1 * v + f2 * v**2 + f3 * v**3
        model = model + ft * load + ft1 * np.exp(-ft2 * load / np.hypot(v, EPSILON))
        return (model - curve.friction) / sigma

    low = np.array([-5, -5, 1e-3, 1e-3, -20, -50, -50, -1, -5, 1e-4])
    high = np.array([5, 5, 2, 2, 20, 50, 50, 1, 5, 1.0])
    random, best = np.random.default_rng(0), np.inf
    for _ in range(starts):
        start = low + (high - low) * random.uniform(size=len(low))
        found = least_squares(residual, start, bounds=(low, high), x_scale=high - low)
        best = min(best, 2.0 * found.cost)
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=4)
    starts = parser.parse_args().starts
    robot = lieid.robots.panda()
    recorded = list(runs(robot))
    fit_friction(friction_curve(robot, recorded[0], 0), MODEL)  # compiled and loaded
    spent = np.zeros((3, 7))
    ours, theirs = np.zeros(7), np.zeros(7)
    wall = 0.0
    for joint, recording in enumerate(recorded):
        clock, began = time.process_time(), time.perf_counter()
        curve = friction_curve(robot, recording, joint)
        spent[0, joint] = time.process_time() - clock
        clock = time.process_time()
        fit = fit_friction(curve, MODEL, starts=starts)
        spent[1, joint] = time.process_time() - clock
        wall += time.perf_counter() - began
        ours[joint] = np.sum(((curve.friction - fit.predicted) / np.maximum(curve.std, 1e-4)) ** 2)
        clock = time.process_time()
        theirs[joint] = peer(curve, starts)
        spent[2, joint] = time.process_time() - clock
    began = time.perf_counter()
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # as `identify_in_stages` does
        list(pool.map(lambda j: fit_friction(friction_curve(robot, recorded[j], j), MODEL,
                                             starts=starts), range(7)))  # fmt: skip
    together = time.perf_counter() - began
    curves, fits, peers = spent.sum(axis=1)
    lines = (
        f"points per curve: {len(curve.speed)}; samples: {sum(len(r) for r in recorded)}",
        f"curves {curves:.2f} s, fits {fits:.2f} s: {curves + fits:.2f} s; wall {wall:.2f} s",
        f"joints side by side on {os.cpu_count()} cores: wall {together:.2f} s",
        f"scipy, {starts} starts: {peers:.2f} s, {peers / fits:.1f} times the fits",
        f"weighted squares, scipy's over ours: {np.round(theirs / ours, 2)}",
    )
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
