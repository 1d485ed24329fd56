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
from hidden_effects.foreign import FOREIGN
from hidden_effects.hidden import CHANGED, MISSING, Ground, Hidden
from hidden_effects.hidden_arms import ARMS, load_arm, write_robot
from hidden_effects.motions import draw_motion
from hidden_effects.nearest import nearest
from hidden_effects.sizes import ROWS, Clean, Space, clean
from numpy.typing import NDArray

from lieid_casadi.plant import (
    Arm,
    JointFriction,
    Motion,
    Sensors,
    Thermal,
    Trajectory,
    measure,
    move,
    move_along,
    perturbed_inertias,
    torque_scale,
)
from lieid_casadi.plant.trajectories import Envelope

Array = NDArray[np.float64]
ATTEMPTS = 80
CLOSE = 0.01  # of the stated size
CLOSE_ENOUGH = 0.05  # on the motion that truly happened, at all instants
ABSORBED = 1e-4  # part of a torque below which nothing is left to find
PLAN_ROWS = 600
SIZES = (5.0, 2.0, 1.0, 0.5)
FINE_RATE, PLAN_RATE, CONTROL_RATE = 1000.0, 200.0, 500.0  # Hz


class Unreachable(ValueError):
    """No plausible arm has this effect at this size."""


@dataclass(frozen=True)
class Case:
    """One case of the benchmark, known by its name.

    Attributes
    ----------
    kind
        ``none``, ``single``, ``pair``, ``triple``, ``foreign``.
    changed
        What has changed since a fit, rather than what the model lacks.
    effect
        Of singles and foreign ones; else drawn.
    size
        Of singles and foreign ones; else drawn from 5, 2, 1.
    """

    kind: str
    draw: int
    changed: bool = False
    effect: str = ""
    size: float = 0.0

    @property
    def name(self) -> str:
        parts = ["changed" if self.changed else "missing", self.kind]
        if self.effect:
            parts += [self.effect, f"{self.size:g}x"]
        return "-".join([*parts, str(self.draw)])

    @classmethod
    def parse(cls, name: str) -> Case:
        mode, kind, *where, draw = name.split("-")
        effect, size = (where[0], float(where[1].removesuffix("x"))) if where else ("", 0.0)
        return cls(kind, int(draw), mode == "changed", effect, size)


@dataclass(frozen=True, eq=False)
class Drawn:
    """All of a case; ``truth`` is what a score may see, but no tool."""

    arm_name: str
    arms: tuple[Arm, Arm]
    motions: tuple[Motion, Motion]
    sensors: Sensors
    noise: Array
    truth: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Stage:
    """An arm before anything is hidden, what it will do, and its sensors."""

    arm_name: str
    arm: Arm
    plans: tuple[Trajectory, Trajectory]
    kinds: tuple[str, str]
    thermal: tuple[Thermal, Thermal]
    sensors: Sensors
    noise: Array
    simulated: bool
    changed: bool

    @property
    def counts(self) -> int:
        """The run whose size counts: training, or after the change."""
        return 1 if self.changed else 0


def draw(case: Case) -> Drawn:
    """Return the case; the same name gives the same case.

    Raises
    ------
    Unreachable
        Where the effect is absorbed or would have to be implausibly strong every time.
    """
    for attempt in range(ATTEMPTS):
        random = np.random.default_rng([zlib.crc32(case.name.encode()), attempt])
        stage = _stage(case, random, 0.95**attempt)
        hidden, targets = _choose(case, stage, random)
        if hidden is None:
            continue
        if not all(h.simulated for h in hidden):
            stage = replace(stage, simulated=False)
        found = _strengths(stage, hidden, targets)
        if found is not None:
            return _finish(case, stage, hidden, targets, found, attempt)
    raise Unreachable(f"{case.name}: no plausible arm in {ATTEMPTS} attempts")


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


def _stage(case: Case, random: np.random.Generator, quiet: float) -> Stage:
    """Return arm, motions and sensors; ``quiet`` lowers the noise, for effects that stay small."""
    arm_name = str(random.choice(ARMS))
    robot = load_arm(arm_name)
    scale, speed = torque_scale(robot), Envelope.of(robot).velocity
    friction = JointFriction(
        coulomb=scale * random.uniform(0.01, 0.06, robot.n),
        viscous=scale / speed * random.uniform(0.01, 0.06, robot.n),
        offset=scale * random.uniform(-0.01, 0.01, robot.n),
    )
    parameters = perturbed_inertias(robot, seed=int(random.integers(2**31)))
    duration = float(random.uniform(28.0, 36.0))
    kinds = str(random.choice(["fourier", "fourier", "mixture", "poses"])), str(
        random.choice(["fourier", "mixture", "poses"])
    )
    plans = tuple(draw_motion(robot, kind, duration, random) for kind in kinds)
    sensors, noise = _sensors(robot, scale * quiet, speed, random)
    return Stage(
        arm_name, Arm(robot, parameters, friction), (plans[0], plans[1]), kinds,
        _thermal(case, random), sensors, noise, bool(random.random() < 0.2), case.changed,
    )  # fmt: skip


def _thermal(case: Case, random: np.random.Generator) -> tuple[Thermal, Thermal]:
    def warm() -> Thermal:
        return Thermal(
            start=25.0 + random.uniform(0.0, 6.0),
            rise=random.uniform(6.0, 15.0),
            time_constant=random.uniform(8.0, 30.0),
        )

    first, second = warm(), warm()
    if case.changed:  # before: a joint that keeps its temperature
        first = Thermal(start=25.0, rise=random.uniform(0.0, 0.5), time_constant=20.0)
    return first, second


def _sensors(
    robot: Any, scale: Array, speed: Array, random: np.random.Generator
) -> tuple[Sensors, Array]:
    noise = scale * np.exp(random.uniform(np.log(5e-4), np.log(4e-3)))
    noise = noise * random.uniform(0.7, 1.4, robot.n)
    coloured = float(random.uniform(0.0, 0.7))  # of the variance
    step = 0.2 * noise if random.random() < 0.5 else np.zeros(robot.n)
    rest = noise**2 - step**2 / 12.0
    sensors = Sensors(
        rate=float(random.choice([100.0, 100.0, 125.0, 200.0])),
        counts_per_turn=float(2 ** int(random.integers(17, 21))),
        counts_per_metre=float(random.choice([2e5, 1e6])),
        velocity=str(random.choice(["difference", "difference", "exact", "none"])),  # type: ignore[arg-type]
        velocity_noise=tuple(map(float, speed * random.uniform(0.0, 1e-3))),
        torque_noise=tuple(map(float, np.sqrt((1.0 - coloured) * rest))),
        coloured_noise=tuple(map(float, np.sqrt(coloured * rest))),
        correlation_time=float(np.exp(random.uniform(np.log(0.01), np.log(0.1)))),
        torque_step=tuple(map(float, step)),
    )
    return sensors, noise


def _choose(
    case: Case, stage: Stage, random: np.random.Generator
) -> tuple[list[Hidden] | None, list[float]]:
    """Return the effects and the sizes they should have; None where one cannot be placed."""
    library = CHANGED if case.changed else MISSING
    count = {"none": 0, "single": 1, "foreign": 1, "pair": 2, "triple": 3}[case.kind]
    if case.kind in ("single", "foreign"):
        names, targets = [case.effect], [case.size]
    else:
        names = [str(x) for x in random.choice(list(library), count, replace=False)]
        targets = [float(x) for x in random.choice(SIZES[:3], count)]
    if {"temperature_friction", "warm_up"} <= set(names):
        return None, []
    plan = stage.plans[stage.counts]
    t = np.arange(0.0, plan.duration, 0.01)
    motion = move_along(stage.arm, t, *plan.at(t))
    ground = Ground(
        stage.arm,
        torque_scale(stage.arm.robot),
        np.abs(motion.dq).max(axis=0),
        np.sqrt(np.mean(motion.dq**2, axis=0)),
        np.abs(motion.rigid).max(axis=0),
        motion.q.min(axis=0),
        motion.q.max(axis=0),
        plan.duration,
        float(stage.sensors.rate or FINE_RATE),
        stage.thermal,
        random,
    )
    hidden = []
    for name in names:
        make = FOREIGN[name] if case.kind == "foreign" else library[name]
        one = make(ground, int(random.integers(stage.arm.n)))
        if one is None:
            return None, []
        hidden.append(one)
    return hidden, targets


class Sizing:
    """How much of each effect is left on a motion of the links."""

    def __init__(
        self, stage: Stage, t: Array, path: tuple[Array, Array, Array], rows: int = ROWS
    ) -> None:
        self.stage, self.t, self.path, self.rows = stage, t, path, rows
        self.base = self._record(self._arm([], []))
        self._space = Space(stage.arm.robot, self.base, stage.noise)

    def _arm(self, hidden: list[Hidden], strengths: list[float]) -> Arm:
        return hide(self.stage, hidden, strengths, self.stage.counts)

    def _record(self, arm: Arm) -> Clean:
        record = clean(arm, move_along(arm, self.t, *self.path), self.rows)
        return replace(record, moving=self.base.moving) if hasattr(self, "base") else record

    def contribution(self, hidden: Hidden, strength: float) -> tuple[Space, Array]:
        """Return the space of columns and the torque (R,) that is the effect's, over noise.

        It is the measured torque less what the arm without the effect would take on the motion
        that the encoders show.
        """
        arm = self._arm([hidden], [strength])
        record = self._record(arm)
        base = self._arm([], [])
        # The encoders' motion may differ from the links': then its own columns count.
        if np.array_equal(record.q, self.base.q) and np.array_equal(record.dq, self.base.dq):
            space, expected = self._space, self.base.tau
        else:
            space = Space(arm.robot, record, self.stage.noise)
            shown = move_along(base, record.t, record.q, record.dq, record.ddq)
            expected = shown.tau
        return space, space.stacked(record.tau - expected)

    def left(self, space: Space, torque: Array, beside: list[Array]) -> Array:
        """Return what is left of a torque (R,) when all else has been fitted."""
        others = np.column_stack(beside) if beside else None
        if not self.stage.changed:
            return space.left(torque, others)
        if others is None:
            return torque
        return torque - others @ np.linalg.lstsq(others, torque, rcond=None)[0]

    def size(
        self, hidden: Hidden, strength: float, beside: list[Array]
    ) -> tuple[float, float, Array, Space]:
        """Return size, part of the torque that is left, what is left (R,), and the space."""
        space, torque = self.contribution(hidden, strength)
        left = self.left(space, torque, beside)
        whole = float(np.linalg.norm(torque))
        part = float(np.linalg.norm(left)) / whole if whole else 0.0
        return float(space.by_joint(left).max()), part, left, space


    def together(
        self, hidden: list[Hidden], strengths: list[float]
    ) -> list[tuple[float, float, Array, Space]]:
        """Return each effect's `size` beside the others."""
        pairs = list(zip(hidden, strengths, strict=True))
        torques = [self.contribution(*pair)[1] for pair in pairs]
        return [
            self.size(*pair, [t for i, t in enumerate(torques) if i != k])
            for k, pair in enumerate(pairs)
        ]


def hide(stage: Stage, hidden: list[Hidden], strengths: list[float], run: int) -> Arm:
    """Return the arm of a run with effects hidden in it (none before a change)."""
    arm = replace(stage.arm, thermal=stage.thermal[run])
    if stage.changed and run == 0:
        return arm
    for one, strength in zip(hidden, strengths, strict=True):
        arm = one.hide(arm, strength, run)
    return arm


def _planned(stage: Stage, run: int, rate: float) -> tuple[Array, tuple[Array, Array, Array]]:
    plan = stage.plans[run]
    t = np.arange(round(plan.duration * rate) + 1) / rate
    return t, plan.at(t)


def _strengths(stage: Stage, hidden: list[Hidden], targets: list[float]) -> list[float] | None:
    """Return strengths that give the sizes on the planned motion; None where implausible."""
    if not hidden:
        return []
    sizing = Sizing(stage, *_planned(stage, stage.counts, PLAN_RATE), PLAN_ROWS)
    strengths = [
        _alone(sizing, one, target) for one, target in zip(hidden, targets, strict=True)
    ]
    if any(s is None for s in strengths):
        return None
    if len(hidden) == 1:
        return strengths
    for _ in range(6):
        sizes = [size for size, *_ in sizing.together(hidden, strengths)]
        ratios = np.array(targets) / np.maximum(sizes, 1e-12)
        if np.all(np.abs(ratios - 1.0) < CLOSE):
            return strengths
        strengths = [float(s * r) for s, r in zip(strengths, ratios, strict=True)]
        if not all(h.least <= s <= h.most for s, h in zip(strengths, hidden, strict=True)):
            return None
    return None


def _alone(sizing: Sizing, one: Hidden, target: float) -> float | None:
    """Return the strength that gives one effect its size, by the secant of the logarithms."""
    if np.isfinite(one.most):
        # At the limits first: most implausible draws end here.
        s = one.most
        size, part, _, _ = sizing.size(one, s, [])
        if size < target or part < ABSORBED:
            return None
    else:
        s = float(target * sizing.stage.noise[one.joints[0]])
        size = sizing.size(one, s, [])[0]
    if one.least and sizing.size(one, one.least, [])[0] > target:
        return None
    slope = 1.0
    for _ in range(12):
        if size <= 0.0:
            return None
        if abs(size / target - 1.0) < CLOSE:
            return s
        new = float(np.clip(s * (target / size) ** (1.0 / slope), one.least, one.most))
        if new == s:
            return None
        after = sizing.size(one, new, [])[0]
        if after > 0.0:
            slope = float(np.clip(np.log(after / size) / np.log(new / s), 0.5, 2.0))
        s, size = new, after
    return None


def _finish(
    case: Case,
    stage: Stage,
    hidden: list[Hidden],
    targets: list[float],
    strengths: list[float],
    attempt: int,
) -> Drawn:
    """Run both motions; under a controller, correct the strengths by what truly happened."""
    for left in (2, 1, 0):
        arms = hide(stage, hidden, strengths, 0), hide(stage, hidden, strengths, 1)
        counted = _moved(stage, arms, stage.counts)
        sized = _sized(stage, hidden, strengths, counted)
        ratios = [target / s["size"] for target, s in zip(targets, sized, strict=True)]
        if not left or all(abs(ratio - 1.0) < CLOSE_ENOUGH for ratio in ratios):
            break
        strengths = [
            min(s * r, h.most) for s, r, h in zip(strengths, ratios, hidden, strict=True)
        ]
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


def _moved(stage: Stage, arms: tuple[Arm, Arm], run: int) -> Motion:
    if stage.simulated:
        return move(arms[run], stage.plans[run], rate=CONTROL_RATE)
    t, path = _planned(stage, run, FINE_RATE)
    return move_along(arms[run], t, *path, seed=run)


def _sized(
    stage: Stage, hidden: list[Hidden], strengths: list[float], motion: Motion
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
        name, explained = nearest(
            space, left, joint, (one.effect, one.joints), kept=stage.changed
        )
        found.append(
            {"size": size, "left_part": part, "left_by_joint": by_joint.tolist(),
             "joint": joint + 1, "nearest": name, "nearest_part": explained}
        )  # fmt: skip
    return found
