# ruff: noqa: T201
"""Diagnose simulated arms under position control whose torque is hidden; one hidden effect each.

Draws alternate between a PD law and a servo's law. The program gets commands, measured positions
and the law. Named is the share of draws whose first step is the hidden effect on its joint; for
draws without a hidden effect, the share without any step. Intervals: the share of base parameters
of arms without a hidden effect, measured by encoders of 4096 counts, inside their 95 % intervals.

    python tests/benchmarks/position_control.py [--draws 60] [--intervals 40] [--hidden NAME]
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pinocchio as pin

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.robot.drive import Drive

ROBOT = lieid.robots.two_link()
HIDDEN = ("none", "load_friction", "command_delay", "deadband", "torque_saturation", "backlash")
EFFECTS = "coulomb,viscous,offset,armature"
ROTOR = (0.2, 0.6)  # inertia of the motors relative to that of the links
SECONDS = 12.0
SENSORS = plant.demo_sensors(ROBOT)
COARSE = replace(SENSORS, counts_per_turn=4096, velocity="none")


def law_of(draw: int, random: np.random.Generator) -> list[Drive]:
    """Return the control laws of a draw: PD, or a servo with limited duty and back-EMF."""
    scale = plant.torque_scale(ROBOT)
    stiffness = scale * random.uniform(4.0, 8.0, ROBOT.n)
    if draw % 2 == 0:
        damping = stiffness * random.uniform(0.01, 0.03)
        pairs = zip(stiffness, damping, strict=True)
        return [Drive(stiffness=k, damping=d) for k, d in pairs]
    speed = 3.0 * ROBOT.limit("velocity")
    stall = 2.0 * ROBOT.limit("torque")
    numbers = zip(stiffness, stall / speed, stall, strict=True)
    return [Drive(stiffness=k, damping=d, proportional_limit=p) for k, d, p in numbers]


def hidden_drive(name: str, law: Drive, largest: float, random: np.random.Generator) -> dict:
    """Return what a drive does besides its law.

    Parameters
    ----------
    name
        Of the hidden effect.
    law
        Of its joint.
    largest
        Largest torque of the joint without it, N·m.
    random
        Source of sizes.
    """
    return {
        "command_delay": {"delay": random.uniform(0.015, 0.05)},
        "deadband": {"deadband": random.uniform(0.02, 0.06) * largest / law.stiffness},
        "torque_saturation": {"limit": random.uniform(0.8, 0.95) * largest},
        "backlash": {"backlash": random.uniform(0.01, 0.03)},
    }.get(name, {})


def geared_arm(seed: int, effect: str | None, joint: int, random: np.random.Generator) -> plant.Arm:
    """Return an arm with motors of a considerable inertia and at most one hidden effect.

    Parameters
    ----------
    seed
        Of the arm.
    effect
        Hidden effect, if any.
    joint
        Of the effect, from 0.
    random
        Source of the inertias.
    """
    arm = plant.demo_arm(ROBOT, seed=seed, hidden=effect, joint=joint)
    model = arm.rigid_model()
    links = 1.0 / np.diag(np.linalg.inv(pin.crba(model, model.createData(), np.zeros(ROBOT.n))))
    rotors = random.uniform(*ROTOR, ROBOT.n) * links
    return arm.with_effects(*(plant.Armature(j, inertia) for j, inertia in enumerate(rotors)))


def recordings(name: str, joint: int, draw: int) -> tuple[list[lieid.Recording], list]:
    """Return two recordings of an arm with one hidden effect, and its laws."""
    random = np.random.default_rng(draw)
    laws = law_of(draw, random)
    effect = name if name == "load_friction" else None
    arm = geared_arm(draw, effect, joint, random)
    rate = 1.0 / SECONDS
    paths = [
        plant.FourierTrajectory(ROBOT, base_frequency=rate, harmonics=5, seed=2 * draw + k)
        for k in range(2)
    ]
    if name == "torque_saturation":
        base = [_run(arm, path, laws, joint, {}, draw) for path in paths[:1]]
        error = base[0].command - base[0].q
        largest = laws[joint].stiffness * np.abs(error[:, joint]).max()
    else:
        largest = float(plant.torque_scale(ROBOT)[joint])
    change = hidden_drive(name, laws[joint], largest, random)
    return [_run(arm, path, laws, joint, change, draw) for path in paths], laws


def _run(arm, path, laws, joint, change, seed, sensors=SENSORS):  # type: ignore[no-untyped-def]
    drives = [
        plant.PositionDrive(law.stiffness, law.damping, limit=law.proportional_limit)
        for law in laws
    ]
    drives[joint] = replace(drives[joint], **change)
    return plant.simulate_commands(
        arm, path, drives, duration=SECONDS, command_rate=1000.0,
        sensors=sensors, seed=seed, name=f"run{seed}.csv",
    )  # fmt: skip


def intervals(draws: int) -> np.ndarray:
    """Return which base parameters (draws, p) are inside their 95 % intervals."""
    found = []
    for draw in range(1000, 1000 + draws):
        random = np.random.default_rng(draw)
        laws = law_of(draw, random)
        arm = geared_arm(draw, None, 0, random)
        path = plant.FourierTrajectory(
            ROBOT, base_frequency=1.0 / SECONDS, harmonics=5, seed=2 * draw
        )
        robot = ROBOT.with_drives(laws)
        train = _run(arm, path, laws, 0, {}, draw, COARSE).with_drives(robot.drives)
        found.append(inside(lieid.identify(lieid.Model(robot, EFFECTS), train), arm))
    return np.array(found)


def inside(fit: lieid.Fit, arm: plant.Arm) -> np.ndarray:
    """Return which base parameters are within their 95 % intervals."""
    friction = arm.friction
    effects = [friction.coulomb, friction.viscous, friction.offset, arm.armature]
    full = np.concatenate([arm.parameters, *effects])
    return np.abs(fit.values - fit.model.base.combination @ full) < 1.96 * fit.std


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--intervals", type=int, default=40, help="draws for the intervals")
    parser.add_argument("--hidden", choices=HIDDEN, help="only draws with this effect")
    args = parser.parse_args()
    right: dict[str, list[bool]] = defaultdict(list)
    for draw in range(args.draws):
        name, joint = HIDDEN[(draw // 2) % len(HIDDEN)], draw // 24 % 2
        if args.hidden not in (None, name):
            continue
        runs, laws = recordings(name, joint, draw)
        robot = ROBOT.with_drives(laws)
        train, test = (run.with_drives(robot.drives) for run in runs)
        model = lieid.Model(robot, EFFECTS)
        found = lieid.diagnose(model, train, test)
        steps = [(step.effect, step.joints) for step in found.steps]
        good = steps[:1] == [(name, (joint,))] if name != "none" else not steps
        right[name].append(good)
        print(f"{draw:3d} {name:18s} joint {joint + 1}: {found.verdict:13s} {steps}", flush=True)
    for name, results in right.items():
        print(f"{name:18s} {sum(results)} of {len(results)}")
    every = [good for results in right.values() for good in results]
    if every:
        print(f"all                {sum(every)} of {len(every)}")
    if args.intervals:
        within = intervals(args.intervals)
        print(f"inside their 95 % intervals: {within.mean():.1%} of {within.size} parameters")
        print(f"least of one parameter: {within.mean(axis=0).min():.1%}")


if __name__ == "__main__":
    main()
