"""Draw a case of the benchmark from its name: arm, motions, sensors, what is hidden, how strong.

A strength is chosen so that the effect's true torque, projected off the rigid and plain friction
columns along the noiseless motion, has a stated multiple of the torque noise's RMS on the joint
where it shows most. With several effects, each is projected off the others as well. For what has
changed, the model is kept and nothing is projected but the other effects.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from hidden_effects.hidden import Hidden
from hidden_effects.hidden_arms import write_robot
from hidden_effects.motions import Smoothed
from hidden_effects.nearest import nearest
from hidden_effects.stage import Case, Stage, choose, hide, set_up
from hidden_effects.strengths import Sizing, find_strengths, planned
from numpy.typing import NDArray

from lieid_casadi.plant import Arm, Sensors, TrueMotion, measure, move, move_along

Array = NDArray[np.float64]
ATTEMPTS = 80
CLOSE_ENOUGH = 0.05  # on the motion that truly happened, at all instants
TOO_FAR = 0.12  # then the case is drawn anew
IMITATED = 0.8  # of what a foreign effect leaves, by one of a library: not foreign enough
FINE_RATE, CONTROL_RATE = 1000.0, 500.0  # Hz


class Unreachable(ValueError):
    """No plausible arm has this effect at this size."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """All of a case; ``truth`` is what a score may see, but no tool."""

    arm_name: str
    arms: tuple[Arm, Arm]
    motions: tuple[TrueMotion, TrueMotion]
    sensors: Sensors
    noise: Array
    truth: dict[str, Any]


def draw(case: Case) -> Drawn:
    """Return the case; the same name gives the same case.

    Raises
    ------
    Unreachable
        Where the effect is absorbed or would have to be implausibly strong every time.
    """
    for attempt in range(ATTEMPTS):
        random = np.random.default_rng([zlib.crc32(case.name.encode()), attempt])
        stage = set_up(case, random, 0.95**attempt)
        hidden, targets = choose(case, stage, random)
        if hidden is None:
            continue
        if not all(h.simulated for h in hidden):
            stage = replace(stage, simulated=False)
        if any(h.elastic for h in hidden):
            first, second = map(Smoothed, stage.plans)
            stage = replace(stage, plans=(first, second), simulated=False)
        found = find_strengths(stage, hidden, targets)
        if found is not None:
            strengths, louder = found
            drawn = _finish(case, stage.louder(louder), hidden, targets, strengths, attempt)
            if _fair(case, drawn.truth):
                return drawn
    raise Unreachable(f"{case.name}: no plausible arm in {ATTEMPTS} attempts")


def _fair(case: Case, truth: dict[str, Any]) -> bool:
    """Whether sizes are what they should be, and a foreign effect is one."""
    effects = truth["effects"]
    if case.kind == "foreign" and any(e["nearest_part"] > IMITATED for e in effects):
        return False
    return all(abs(e["target"] / e["size"] - 1.0) < TOO_FAR for e in effects)


def write(case: Case, folder: Path, truth: Path | None = None) -> dict[str, Any]:
    """Write a case's files into a folder, its truth elsewhere; return the truth."""
    drawn = draw(case)
    folder.mkdir(parents=True, exist_ok=True)
    write_robot(drawn.arm_name, folder)
    names = ("before.csv", "after.csv") if case.changed else ("train.csv", "test.csv")
    seed = zlib.crc32(case.name.encode())
    for k, file in enumerate(names):
        measure(drawn.arms[k], drawn.motions[k], drawn.sensors, seed=seed + k).save(folder / file)
    if truth is not None:
        truth.parent.mkdir(parents=True, exist_ok=True)
        truth.write_text(json.dumps(drawn.truth, indent=1) + "\n", encoding="utf-8")
    return drawn.truth


def _finish(
    case: Case,
    stage: Stage,
    hidden: list[Hidden],
    targets: list[float],
    strengths: list[float],
    attempt: int,
) -> Drawn:
    """Run both motions; under a controller, correct the strengths by what truly happened."""
    for left in (3, 2, 1, 0):
        arms = hide(stage, hidden, strengths, 0), hide(stage, hidden, strengths, 1)
        counted = _moved(stage, arms, stage.counts)
        sized = _sized(stage, hidden, strengths, counted)
        ratios = [target / s["size"] for target, s in zip(targets, sized, strict=True)]
        if not left or all(abs(ratio - 1.0) < CLOSE_ENOUGH for ratio in ratios):
            break
        for one, ratio in zip(hidden, ratios, strict=True):
            if one.fixed:
                stage = stage.louder(1.0 / ratio)
                ratios = [r / ratio for r in ratios]
        strengths = [min(s * r, h.most) for s, r, h in zip(strengths, ratios, hidden, strict=True)]
    other = _moved(stage, arms, 1 - stage.counts)
    motions = (other, counted) if stage.changed else (counted, other)
    names = {h.effect for h in hidden}
    random = np.random.default_rng([zlib.crc32(case.name.encode()), 7])
    column = bool(random.random() < 0.35) and "warm_up" not in names
    sensors = replace(stage.sensors, temperature=column or "temperature_friction" in names)
    truth = {
        "case": case.name,
        "mode": "changed" if case.changed else "missing",
        "kind": case.kind,
        "arm": stage.arm_name,
        "effects": [
            {"effect": h.effect, "joints": [j + 1 for j in h.joints], "details": h.details,
             "signals": list(h.signals), "target": target, "strength": strength,
             "most": h.most if np.isfinite(h.most) else None, **size}
            for h, target, strength, size in zip(hidden, targets, strengths, sized, strict=True)
        ],
        "noise": stage.noise.tolist(),
        "motions": list(stage.kinds),
        "simulated": stage.simulated,
        "temperature_column": sensors.temperature,
        "rate": sensors.rate,
        "velocity": sensors.velocity,
        "attempt": attempt,
    }  # fmt: skip
    return Drawn(stage.arm_name, arms, motions, sensors, stage.noise, truth)


def _moved(stage: Stage, arms: tuple[Arm, Arm], run: int) -> TrueMotion:
    if stage.simulated:
        return move(arms[run], stage.plans[run], rate=CONTROL_RATE)
    t, path = planned(stage, run, FINE_RATE)
    return move_along(arms[run], t, *path, seed=run)


def _sized(
    stage: Stage, hidden: list[Hidden], strengths: list[float], motion: TrueMotion
) -> list[dict[str, Any]]:
    """Return each effect's true size on the motion that truly happened."""
    if not hidden:
        return []
    sizing = Sizing(stage, motion.t, (motion.q, motion.dq, motion.ddq))
    found = []
    for one, (size, part, left, space) in zip(
        hidden, sizing.together(hidden, strengths), strict=True
    ):
        by_joint = space.by_joint(left)
        joint = int(np.argmax(by_joint))
        name, explained = nearest(space, left, joint, (one.effect, one.joints), kept=stage.changed)
        found.append(
            {"size": size, "left_part": part, "left_by_joint": by_joint.tolist(),
             "joint": joint + 1, "nearest": name, "nearest_part": explained}
        )  # fmt: skip
    return found
