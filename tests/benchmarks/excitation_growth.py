"""How the time of one design grows with joints, harmonics and samples; and trajectory families.

    python tests/benchmarks/excitation_growth.py [joints] [harmonics] [samples] [families]

Processor time on one core, medians over the starts; criterion ``condition``, joint limits, at rest
in the middle of the ranges.
"""

import sys
import time
from dataclasses import replace

import numpy as np
from arms import panda, six_joints, twelve_joints

import lieid_casadi as lieid
from lieid_casadi.excitation.design import ExcitationProblem, make_design
from lieid_casadi.excitation.search import Search
from lieid_casadi.excitation.trajectory import make
from lieid_casadi.robot import Limits

STARTS = 5
LIMITS = Limits(-2.5, 2.5, 2.5, 5.0)


def limited(robot):
    """The robot with the same limits at every joint."""
    joints = tuple(replace(joint, limits=LIMITS) for joint in robot.joints)
    return replace(robot, joints=joints)


def three_joints():
    arm = six_joints()
    return replace(arm, joints=arm.joints[:3], tool=np.eye(4))


def row(label, robot, *, basis="fourier", harmonics=5, samples=100, duration=20.0):
    chosen = make(basis, harmonics=harmonics, duration=duration)
    design = make_design(
        lieid.Model(robot),
        basis=chosen,
        criterion="condition",
        limits=(),
        samples=samples,
        margin=1.0,
    )
    began = time.process_time()
    problem = ExcitationProblem(design)
    built = time.process_time() - began
    numbers, seconds, counts = [], [], []
    for seed in range(STARTS):
        began = time.process_time()
        solution = Search(problem, seed).solve()
        seconds.append(time.process_time() - began)
        numbers.append(solution.condition_number)
        counts.append(len(solution.history))
    say(
        f"{label:34} {problem.parametrization.size:5} {robot.n:3} {np.median(numbers):8.2f} "
        f"{min(numbers):8.2f} {np.median(seconds):7.2f} s {np.median(counts):5.0f} {built:7.2f} s"
    )


def header():
    say(f"{'':34} {'free':>5} {'n':>3} {'median':>8} {'best':>8} {'solve':>9} {'iter':>5} build")


def joints():
    header()
    for arm in (three_joints(), six_joints(), panda(), twelve_joints()):
        row(f"{arm.n} joints", limited(arm))


def harmonics():
    header()
    for count in (3, 5, 8, 12):
        row(f"{count} harmonics", panda(), harmonics=count, samples=max(100, 16 * count))


def samples():
    header()
    for count in (50, 100, 200, 400, 1000):
        row(f"{count} samples", panda(), samples=count)


def bases():
    """Equal freedom and equal duration."""
    header()
    for duration in (10.0, 20.0):
        for basis in ("fourier", "modified_fourier", "bspline"):
            row(f"{basis}, {duration:g} s", panda(), basis=basis, duration=duration)
        for count in (4, 3):
            row(f"modified_fourier, {count} harmonics, {duration:g} s", panda(),
                basis="modified_fourier", harmonics=count, duration=duration)  # fmt: skip


def say(text):
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    for name in sys.argv[1:] or ["joints", "harmonics", "samples", "bases"]:
        globals()[name]()
