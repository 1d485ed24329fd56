# ruff: noqa: T201
"""Diagnose a simulated Panda along motions that nobody designed for identification.

One effect is hidden on a joint, or none, or a payload was attached since a fit; with ``--changed``
each effect, or more friction or offset, has come since a fit. The motions are
those of recordings that exist anyway: joints that move one after the other or two at a time, cycles
between three poses, teleoperation (each joint to goals and with pauses of its own), bounces at
constant speeds, chirps, one slow swing, few joints, several short recordings. Right is a diagnosis
whose steps are the hidden effect alone. Beside it stands the unseen error in motion of the joint
(of the worst one), without the effect and with what was found, in multiples of the noise floor.

    python tests/benchmarks/motions.py [--motions alone,pairs] [--rate 250] [--changed]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter1d

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.arrays import Array

ROBOT = lieid.robots.panda()
ARM = plant.demo_arm(ROBOT, hidden=None)
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
N, STEP, NOISE = ROBOT.n, 0.002, 0.1  # s, N·m
LOWER, UPPER = ROBOT.limit("position_lower"), ROBOT.limit("position_upper")
MIDDLE, SPAN, SPEED = 0.5 * (LOWER + UPPER), UPPER - LOWER, ROBOT.limit("velocity")
HIDDEN = (
    "none", "stribeck:2", "load_friction:2", "presliding:2", "viscous_polynomial:4",
    "torque_ripple:4", "torque_gain:4", "payload",
)  # fmt: skip
CHANGED = (*HIDDEN[:-1], "coulomb:2", "viscous:4", "offset:4")
STRENGTH, MORE = 4.0, 1.6  # of hidden effects, and how many times as large friction or offset is
Motion = Callable[[np.random.Generator], list[Array]]  # one path (K, n) per recording


def _time(seconds: float) -> Array:
    return np.arange(0.0, seconds, STEP)


def _from_rest_to_rest(t: Array, start: float, duration: float) -> Array:
    """Return the part (K,) of a quintic move that is done."""
    u = np.clip((t - start) / duration, 0.0, 1.0)
    return 10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5


def own_times(random: np.random.Generator, *, seconds: float = 24.0) -> list[Array]:
    """Joints that move to random goals as in teleoperation, each at its own times, with pauses."""
    t = _time(seconds)
    q = np.zeros((len(t), N)) + MIDDLE + random.uniform(-0.3, 0.3, N)
    for joint in range(N):
        at, end = 0.0, 0.0
        while end < seconds:
            end += random.uniform(0.0, 0.8)
            duration, goal = random.uniform(0.3, 1.2), random.uniform(-0.25, 0.25) * SPAN[joint]
            q[:, joint] += (goal - at) * _from_rest_to_rest(t, end, duration)
            at, end = goal, end + duration
    return [gaussian_filter1d(q, 15, axis=0, mode="nearest")]


def several(random: np.random.Generator) -> list[Array]:
    """Six recordings of 4 s."""
    return [path for _ in range(6) for path in own_times(random, seconds=4.0)]


def few_joints(random: np.random.Generator) -> list[Array]:
    """Joints 2 and 4 alone move."""
    (q,) = own_times(random)
    return [np.where(np.isin(np.arange(N), (1, 3)), q, MIDDLE + 0.1)]


def alone(random: np.random.Generator) -> list[Array]:
    """Joints that swing one after the other, each for 4 s."""
    own = _time(4.0)
    q = np.zeros((N * len(own), N)) + MIDDLE
    for joint in range(N):
        swing = np.sin(2.0 * np.pi * random.uniform(0.5, 2.0) * own)
        here = slice(joint * len(own), (joint + 1) * len(own))
        q[here, joint] += random.uniform(0.2, 0.5) * np.sin(np.pi * own / 4.0) ** 3 * swing
    return [q]


def pairs(random: np.random.Generator) -> list[Array]:
    """Two neighbouring joints at a time."""
    t = _time(4.0 * N)
    (q,) = own_times(random, seconds=4.0 * N)
    moved = np.zeros_like(q) + MIDDLE
    for k in range(N):
        here = (t >= 4.0 * k) & (t < 4.0 * (k + 1))
        for joint in (k, (k + 1) % N):
            way = q[here, joint] - MIDDLE[joint]
            moved[here, joint] += np.sin(np.pi * t[here] / 4.0) ** 2 * way
    return [gaussian_filter1d(moved, 10, axis=0, mode="nearest")]


def cycle(random: np.random.Generator) -> list[Array]:
    """Moves between three poses, again and again."""
    t, poses = _time(24.0), MIDDLE + random.uniform(-0.3, 0.3, (3, N)) * SPAN
    q = np.zeros((len(t), N)) + poses[0]
    for k in range(15):
        way = poses[(k + 1) % 3] - poses[k % 3]
        q += way * _from_rest_to_rest(t, 0.3 + 1.6 * k, 1.2)[:, None]
    return [gaussian_filter1d(q, 10, axis=0, mode="nearest")]


def bounces(random: np.random.Generator) -> list[Array]:
    """Joints that go to and fro, each time at another constant speed."""
    t = _time(24.0)
    q = np.zeros((len(t), N)) + MIDDLE
    for joint in range(N):
        times, places, side = [0.0], [0.0], 1.0
        while times[-1] < t[-1]:
            speed, width = random.uniform(0.05, 0.6) * SPEED[joint], random.uniform(0.1, 0.35)
            times.append(times[-1] + max(width * SPAN[joint] / speed, 0.3))
            places.append(0.5 * side * width * SPAN[joint])
            side = -side
        q[:, joint] += np.interp(t, times, places)
    return [gaussian_filter1d(q, 40, axis=0, mode="nearest")]


def chirps(random: np.random.Generator) -> list[Array]:
    """Joints that swing ever faster, or ever slower."""
    t = _time(20.0)
    q = np.zeros((len(t), N)) + MIDDLE
    for joint in range(N):
        f = np.linspace(0.1, 1.5, len(t))[:: 1 if random.random() < 0.5 else -1]
        size = np.minimum(0.15 * SPAN[joint], 0.5 * SPEED[joint] / (2.0 * np.pi * f))
        q[:, joint] += size * np.sin(2.0 * np.pi * np.cumsum(f) * STEP + random.uniform(0.0, 6.0))
    return [gaussian_filter1d(q, 10, axis=0, mode="nearest")]


def slow(random: np.random.Generator) -> list[Array]:
    """Three waves per joint, of 30, 15 and 10 s."""
    t = _time(30.0)
    waves = np.zeros((len(t), N)) + MIDDLE
    for f in (1 / 30, 2 / 30, 3 / 30):
        phase = 2.0 * np.pi * f * t[:, None] + random.uniform(0.0, 6.0, N)
        waves += random.uniform(0.1, 0.25, N) * np.sin(phase)
    return [waves]


MOTIONS: dict[str, Motion] = {
    "own_times": own_times,
    "own_times_6s": partial(own_times, seconds=6.0),
    "several": several,
    "few_joints": few_joints,
    "alone": alone,
    "pairs": pairs,
    "cycle": cycle,
    "bounces": bounces,
    "chirps": chirps,
    "slow": slow,
}


def recorded(arm: plant.Arm, motion: Motion, seed: int, rate: float) -> list[lieid.Recording]:
    """Return the recordings of an arm along a motion, of which the seed is also that of noise."""
    sensors, found = plant.Sensors(rate=rate, torque_noise=NOISE), list[lieid.Recording]()
    for k, q in enumerate(motion(np.random.default_rng(seed))):
        dq = np.gradient(q, STEP, axis=0)
        along = STEP * np.arange(len(q)), q, dq, np.gradient(dq, STEP, axis=0)
        found.append(plant.measure_along(arm, *along, sensors=sensors, seed=10 * seed + k))
    return found


def with_hidden(hidden: str) -> plant.Arm:
    """Return the arm with an effect, or with more of the friction or offset that it has."""
    name, _, joint = hidden.partition(":")
    if hidden == "none":
        return ARM
    if hidden == "payload":
        return ARM.with_effects(plant.Payload(1.0, (0.02, -0.01, 0.04), 1e-6))
    if name in ("coulomb", "viscous", "offset"):
        values = getattr(ARM.friction, name).copy()
        values[int(joint) - 1] *= MORE
        return replace(ARM, friction=replace(ARM.friction, **{name: values}))
    return ARM.with_effects(plant.hidden_effect(ARM, name, int(joint) - 1, strength=STRENGTH))


def diagnosed(motion: Motion, hidden: str, rate: float, *, changed: bool) -> lieid.Diagnosis:
    """Return the diagnosis of an arm with a hidden effect."""
    arm = with_hidden(hidden)
    if changed or hidden == "payload":
        fit = lieid.identify(MODEL, recorded(ARM, motion, 3, rate))
        return lieid.diagnose(fit, recorded(arm, motion, 2, rate))
    return lieid.diagnose(MODEL, recorded(arm, motion, 1, rate), recorded(arm, motion, 2, rate))


def line(motion: str, hidden: str, found: lieid.Diagnosis) -> tuple[bool, str]:
    """Return whether a diagnosis is right, and a line about it."""
    labels = [step.label for step in found.steps]
    right = labels == ([] if hidden == "none" else [hidden])
    with_found = (found.steps[-1].errors if found.steps else found.baseline)["rms_test_moving"]
    every = [x / found.noise_floor for x in (found.baseline["rms_test_moving"], with_found)]
    joint = int(hidden[-1]) - 1 if ":" in hidden else int(np.nanargmax(every[0]))
    errors = " to ".join(f"{x[joint]:.1f}" for x in every)
    text = f"{motion:13s} {hidden:21s} {'right' if right else '':6s} joint {joint + 1}: {errors}"
    return right, f"{text}, {found.verdict}: {', '.join(labels) or 'no step'}"


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motions", default=",".join(MOTIONS), help="comma-separated")
    parser.add_argument("--rate", type=float, default=250.0, help="of recordings, Hz")
    parser.add_argument("--changed", action="store_true", help="changes since a fit")
    args = parser.parse_args(argv)
    results = []
    for motion in args.motions.split(","):
        for hidden in CHANGED if args.changed else HIDDEN:
            found = diagnosed(MOTIONS[motion], hidden, args.rate, changed=args.changed)
            right, text = line(motion, hidden, found)
            results.append(right)
            print(text, flush=True)
    print(f"right: {sum(results)} of {len(results)}")


if __name__ == "__main__":
    main()
