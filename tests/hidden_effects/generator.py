"""Draw a case of the benchmark from its name: arm, motions, sensors, effects and strengths.

A strength is chosen so that the effect's true torque, projected off the rigid and plain friction
columns along the noiseless motion, has a stated multiple of the torque noise's RMS on the joint
where it is largest. With several effects, the others are projected out as well. For changes the
model is kept, and only the other effects are projected out.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from hidden_effects.arms import robot_text
from hidden_effects.case_setup import (
    Case,
    CaseSetup,
    choose_effects,
    choose_world,
    draw_setup,
    with_hidden,
)
from hidden_effects.effect_library import ScalableEffect
from hidden_effects.motions import Smoothed
from hidden_effects.sizes import EffectSizes, find_strengths, most_similar, planned
from hidden_effects.worlds import Measured, World

from lieid_casadi import LieidError
from lieid_casadi.arrays import Array
from lieid_casadi.plant import Arm, Sensors, TrueMotion, measure, move, move_along
from lieid_casadi.robot import Robot
from lieid_casadi.robot.yaml_file import write_yaml

ATTEMPTS = 80
SIZE_TOLERANCE = 0.05  # relative, on the simulated motion at all instants
LARGEST_DEVIATION = 0.12  # of a size; above it the case is drawn again
SIMILAR = 0.8  # part of a foreign effect that an effect of a library may explain
FINE_RATE, CONTROL_RATE = 1000.0, 500.0  # Hz


class Unreachable(ValueError):
    """No realistic arm has this effect at this size."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """A case; ``truth`` is used by the score only."""

    arm_name: str
    arms: tuple[Arm, ...]
    motions: tuple[TrueMotion, ...]
    sensors: Sensors
    noise: Array
    world: World
    truth: dict[str, Any]


def draw(case: Case) -> Drawn:
    """Return the case; the same name gives the same case.

    Raises
    ------
    Unreachable
        If the effect is absorbed or would be unrealistically strong in every attempt.
    """
    for attempt in range(ATTEMPTS):
        random = np.random.default_rng([zlib.crc32(case.name.encode()), attempt])
        setup = draw_setup(case, random, 0.95**attempt)
        hidden, targets = choose_effects(case, setup, random)
        if hidden is None:
            continue
        if not all(h.simulated for h in hidden):
            setup = replace(setup, simulated=False)
        if any(h.elastic for h in hidden):
            setup = replace(setup, plans=tuple(map(Smoothed, setup.plans)), simulated=False)
        found = find_strengths(setup, hidden, targets)
        if found is not None:
            strengths, noise_factor = found
            setup = setup.with_noise(noise_factor)
            world = choose_world(case, setup, random)
            try:
                drawn = _finish(case, setup, hidden, targets, strengths, world, attempt)
            except LieidError:  # the controller does not hold the arm
                continue
            if _is_valid(case, drawn.truth):
                return drawn
    raise Unreachable(f"{case.name}: no realistic arm in {ATTEMPTS} attempts")


def _is_valid(case: Case, truth: dict[str, Any]) -> bool:
    """Whether sizes are close to their targets, and a foreign effect differs from all others."""
    effects = truth["effects"]
    if case.kind == "foreign" and any(e["nearest_part"] > SIMILAR for e in effects):
        return False
    return all(abs(e["target"] / e["size"] - 1.0) < LARGEST_DEVIATION for e in effects)


def write(case: Case, folder: Path, truth: Path | None = None) -> dict[str, Any]:
    """Write the files of a case into a folder and its truth to another file; return the truth.

    Raises
    ------
    Unreachable
        If there is no such arm, or its simulated motion diverges.
    """
    drawn = draw(case)
    folder.mkdir(parents=True, exist_ok=True)
    _write_robot(drawn, folder)
    seed = zlib.crc32(case.name.encode())
    for k, name in enumerate(_recording_names(drawn)):
        arm, motion = drawn.arms[k], drawn.motions[k]
        try:
            recording = measure(arm, motion, drawn.sensors, seed=seed + k)
        except LieidError as error:
            raise Unreachable(f"{case.name}: {error}") from None
        run = Measured(recording, arm, motion, drawn.noise, np.random.default_rng([seed, k, 9]))
        drawn.world.record(run).save(folder / f"{name}.csv")
    if truth is not None:
        truth.parent.mkdir(parents=True, exist_ok=True)
        truth.write_text(json.dumps(drawn.truth, indent=1) + "\n", encoding="utf-8")
    return drawn.truth


def _write_robot(drawn: Drawn, folder: Path) -> None:
    file, text = robot_text(drawn.arm_name)
    if drawn.world.name:  # worlds describe a robot as YAML
        robot = Robot.parse_yaml(text) if file.endswith(".yaml") else Robot.parse_urdf(text)
        file, text = "robot.yaml", drawn.world.describe(write_yaml(robot))
    (folder / file).write_text(text, encoding="utf-8")


def _recording_names(drawn: Drawn) -> list[str]:
    """Return the file names; ``unseen`` is for the score alone."""
    if drawn.truth["mode"] == "changed":
        return ["before", "after"]
    trainings = [f"train{k + 1}" for k in range(len(drawn.motions) - 1)]
    return [*trainings, "test" if drawn.truth["tested"] else "unseen"]


def _finish(
    case: Case,
    setup: CaseSetup,
    hidden: list[ScalableEffect],
    targets: list[float],
    strengths: list[float],
    world: World,
    attempt: int,
) -> Drawn:
    """Run all motions; with a controller, correct the strengths for the simulated motion."""
    runs = range(len(setup.plans))
    for attempts_left in (3, 2, 1, 0):
        arms = [world.hide(with_hidden(setup, hidden, strengths, k), k) for k in runs]
        counted = moved(setup, arms, setup.counts)
        sized = _sized(setup, hidden, strengths, counted)
        ratios = [target / s["size"] for target, s in zip(targets, sized, strict=True)]
        if not attempts_left or all(abs(ratio - 1.0) < SIZE_TOLERANCE for ratio in ratios):
            break
        for one, ratio in zip(hidden, ratios, strict=True):
            if one.fixed:
                setup = setup.with_noise(1.0 / ratio)
                ratios = [r / ratio for r in ratios]
        strengths = [min(s * r, h.most) for s, r, h in zip(strengths, ratios, hidden, strict=True)]
    motions = [counted if k == setup.counts else moved(setup, arms, k) for k in runs]
    names = {h.effect for h in hidden}
    random = np.random.default_rng([zlib.crc32(case.name.encode()), 7])
    column = bool(random.random() < 0.35) and "warm_up" not in names
    sensors = replace(setup.sensors, temperature=column or "temperature_friction" in names)
    truth = {
        "case": case.name,
        "mode": "changed" if case.changed else "missing",
        "kind": case.kind,
        "arm": setup.arm_name,
        "effects": [
            {"effect": h.effect, "joints": [j + 1 for j in h.joints], "details": h.details,
             "signals": list(h.signals), "accepted": list(h.accepted),
             "target": target, "strength": strength,
             "most": h.most if np.isfinite(h.most) else None, **size}
            for h, target, strength, size in zip(hidden, targets, strengths, sized, strict=True)
        ],
        "noise": setup.noise.tolist(),
        "motions": list(setup.kinds),
        "tested": setup.tested,
        "allowed": [[name, list(joints)] for name, joints in world.allowed],
        "simulated": setup.simulated,
        "duration": round(counted.t[-1], 1),
        "correlation_time": sensors.correlation_time,
        "correlated_part": float(np.mean(np.square(sensors.coloured_noise) / setup.noise**2)),
        "temperature_column": sensors.temperature,
        "rate": sensors.rate,
        "velocity": sensors.velocity,
        "attempt": attempt,
    }  # fmt: skip
    return Drawn(setup.arm_name, tuple(arms), tuple(motions), sensors, setup.noise, world, truth)


def moved(setup: CaseSetup, arms: list[Arm], run: int) -> TrueMotion:
    """Return the motion of a run."""
    if setup.simulated:
        return move(arms[run], setup.plans[run], rate=CONTROL_RATE)
    t, path = planned(setup, run, FINE_RATE)
    return move_along(arms[run], t, *path, seed=run)


def _sized(
    setup: CaseSetup, hidden: list[ScalableEffect], strengths: list[float], motion: TrueMotion
) -> list[dict[str, Any]]:
    """Return the true size of each effect on the simulated motion."""
    if not hidden:
        return []
    sizing = EffectSizes(setup, motion.t, (motion.q, motion.dq, motion.ddq))
    found = []
    for one, (size, part, left, span) in zip(
        hidden, sizing.together(hidden, strengths), strict=True
    ):
        by_joint = span.by_joint(left)
        joint = int(np.argmax(by_joint))
        name, explained = most_similar(
            span, left, joint, (one.effect, one.joints), kept=setup.changed
        )
        found.append(
            {"size": size, "left_part": part, "left_by_joint": by_joint.tolist(),
             "deviations": round(sizing.deviations(span, left), 1),
             "joint": joint + 1, "nearest": name, "nearest_part": explained}
        )  # fmt: skip
    return found
