"""Arm, motions and sensors of a case, and the effects to hide, all drawn from its name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from hidden_effects.arms import ARMS, load_arm
from hidden_effects.effect_library import CHANGED, MISSING, ReferenceMotion, ScalableEffect
from hidden_effects.foreign import FOREIGN, FORMS
from hidden_effects.motions import draw_motion
from hidden_effects.worlds import WORLDS, World

from lieid_casadi.arrays import Array
from lieid_casadi.plant import (
    Arm,
    JointFriction,
    ReferenceTrajectory,
    Sensors,
    Thermal,
    move_along,
    perturbed_inertias,
    torque_scale,
)
from lieid_casadi.plant.trajectories import Envelope

LEAST_NOISE, MOST_NOISE = 1e-4, 1.5e-2  # relative to the torque that the drives can deliver
LATER = 100  # draws from here on have noise correlated over up to 1 s, and recordings of 15 s
TRAININGS = {"tilted_run": 2}  # recordings for training that a world needs
SIZES = (5.0, 2.0, 1.0, 0.5)
DURATIONS, DURATIONS_OF_SEVERAL = (15.0, 60.0), (15.0, 30.0)  # s, of one and of each of several
#: What six effects of one arm are drawn from, and their sizes: real arms lack many at once, most of
#: them friction, and some of them large.
COMMON = (
    *(2 * ("stribeck", "load_friction", "viscous_polynomial", "presliding")),
    "viscous_asymmetric", "position_friction", "temperature_friction", "torque_ripple",
    "torque_lowpass", "torque_gain", "armature", "encoder_offset",
)  # fmt: skip
SIZES_OF_SIX = (1.5, 12.0)
SHORT = 0.4  # part of the later cases whose recordings have the shortest duration


@dataclass(frozen=True)
class Case:
    """One case of the benchmark, defined by its name.

    Even draws are for setting thresholds (``tune``), odd ones for the published table (``sealed``).
    ``changed``: effects changed since a fit; otherwise the model lacks them. ``effect`` is the
    hidden one of single, foreign and form, the violated assumption of a world, and the correlation
    time, such as ``0.2s``, of correlated (nothing hidden). Sizes that are not stated are drawn.
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
            parts.append(self.effect)
        if self.size:
            parts.append(f"{self.size:g}x")
        return "-".join([*parts, str(self.draw)])

    @classmethod
    def parse(cls, name: str) -> Case:
        mode, kind, *where, draw = name.split("-")
        effect = where[0] if where else ""
        size = float(where[1].removesuffix("x")) if len(where) > 1 else 0.0
        return cls(kind, int(draw), mode == "changed", effect, size)

    @property
    def half(self) -> str:
        return "sealed" if self.draw % 2 else "tune"

    @property
    def series(self) -> int:
        return 2 if self.draw >= LATER else 1


@dataclass(frozen=True, eq=False)
class CaseSetup:
    """An arm without hidden effects, its motions and its sensors.

    There is one plan for each recording: before and after a change, else those for training and,
    last, one that is the test of a case with a test.
    """

    arm_name: str
    arm: Arm
    plans: tuple[ReferenceTrajectory, ...]
    kinds: tuple[str, ...]
    thermal: tuple[Thermal, ...]
    sensors: Sensors
    noise: Array
    simulated: bool
    changed: bool
    tested: bool = True

    @property
    def counts(self) -> int:
        """The run on which sizes are defined: the first for training, or after the change."""
        return 1 if self.changed else 0

    def plausible(self, factor: float) -> bool:
        """Whether noise times a factor is realistic relative to the torque of the drives."""
        level = factor * float(np.mean(self.noise / torque_scale(self.arm.robot)))
        return LEAST_NOISE <= level <= MOST_NOISE

    def with_noise(self, factor: float) -> CaseSetup:
        """Return the setup with the noise times a factor."""
        sensors = replace(
            self.sensors,
            **{
                name: tuple(factor * x for x in getattr(self.sensors, name))
                for name in ("torque_noise", "coloured_noise", "torque_step")
            },
        )
        return replace(self, sensors=sensors, noise=factor * self.noise)


def with_hidden(
    setup: CaseSetup, hidden: list[ScalableEffect], strengths: list[float], run: int
) -> Arm:
    """Return the arm of a run with hidden effects; before a change it has none."""
    arm = replace(setup.arm, thermal=setup.thermal[run])
    if setup.changed and run == 0:
        return arm
    for one, strength in zip(hidden, strengths, strict=True):
        arm = one.hide(arm, strength, run)
    return arm


def draw_setup(case: Case, random: np.random.Generator, noise_factor: float) -> CaseSetup:
    """Return arm, motions and sensors; the noise is multiplied by ``noise_factor``."""
    arm_name = str(random.choice(ARMS))
    robot = load_arm(arm_name)
    scale, speed = torque_scale(robot), Envelope.of(robot).velocity
    friction = JointFriction(
        coulomb=scale * random.uniform(0.01, 0.06, robot.n),
        viscous=scale / speed * random.uniform(0.01, 0.06, robot.n),
        offset=scale * random.uniform(-0.01, 0.01, robot.n),
    )
    parameters = perturbed_inertias(robot, seed=int(random.integers(2**31)))
    runs = 2 if case.changed else 1 + _trainings(case, random)
    shortest, longest = DURATIONS if runs == 2 else DURATIONS_OF_SEVERAL
    if case.kind == "correlated":
        longest = min(longest, DURATIONS_OF_SEVERAL[1])
    if case.series == 2 and random.random() < SHORT:
        longest = shortest
    kinds = tuple(
        str(random.choice(["fourier", "fourier", "mixture", "poses"])) for _ in range(runs)
    )
    plans = tuple(
        draw_motion(
            robot, kind, float(np.exp(random.uniform(np.log(shortest), np.log(longest)))), random
        )
        for kind in kinds
    )
    sensors, noise = _sensors(robot, scale * noise_factor, speed, random)
    if case.series == 2:
        sensors = _correlated(case, sensors, noise, random)
    return CaseSetup(
        arm_name, Arm(robot, parameters, friction), plans, kinds, _thermal(case, runs, random),
        sensors, noise, bool(random.random() < 0.2), case.changed, bool(random.random() < 0.5),
    )  # fmt: skip


def _trainings(case: Case, random: np.random.Generator) -> int:
    """Return the number of recordings for training."""
    drawn = int(random.choice([1, 1, 3]))
    return TRAININGS.get(case.effect, drawn) if case.kind == "world" else drawn


def _thermal(case: Case, runs: int, random: np.random.Generator) -> tuple[Thermal, ...]:
    thermal = [
        Thermal(
            start=25.0 + random.uniform(0.0, 6.0),
            rise=random.uniform(6.0, 15.0),
            time_constant=random.uniform(8.0, 30.0),
        )
        for _ in range(runs)
    ]
    if case.changed:  # before the change the temperature is nearly constant
        thermal[0] = Thermal(start=25.0, rise=random.uniform(0.0, 0.5), time_constant=20.0)
    return tuple(thermal)


def _sensors(
    robot: Any, scale: Array, speed: Array, random: np.random.Generator
) -> tuple[Sensors, Array]:
    noise = scale * np.exp(random.uniform(np.log(5e-4), np.log(4e-3)))
    noise = noise * random.uniform(0.7, 1.4, robot.n)
    coloured = float(random.uniform(0.0, 0.7))  # of the variance
    step = 0.2 * noise if random.random() < 0.5 else np.zeros(robot.n)
    rest = noise**2 - step**2 / 12.0
    velocity = str(random.choice(["difference", "difference", "exact", "none"]))
    velocity_noise = speed * random.uniform(0.0, 1e-3) * (velocity == "exact")
    sensors = Sensors(
        rate=float(random.choice([100.0, 100.0, 125.0, 200.0])),
        counts_per_turn=float(2 ** int(random.integers(17, 21))),
        counts_per_metre=float(random.choice([2e5, 1e6])),
        velocity=velocity,  # type: ignore[arg-type]
        velocity_noise=tuple(map(float, velocity_noise)),
        torque_noise=tuple(map(float, np.sqrt((1.0 - coloured) * rest))),
        coloured_noise=tuple(map(float, np.sqrt(coloured * rest))),
        correlation_time=float(np.exp(random.uniform(np.log(0.01), np.log(0.1)))),
        torque_step=tuple(map(float, step)),
    )
    return sensors, noise


def _correlated(case: Case, sensors: Sensors, noise: Array, random: np.random.Generator) -> Sensors:
    """Return the sensors with torque noise correlated over 0 to 1 s, short times more often."""
    time, part = float(random.uniform() ** 2), float(random.uniform(0.0, 1.0))
    if case.kind == "correlated":
        time, part = float(case.effect.removesuffix("s")), 0.7 + 0.3 * part
    rest = noise**2 - np.array(sensors.torque_step) ** 2 / 12.0
    return replace(
        sensors,
        torque_noise=tuple(map(float, np.sqrt((1.0 - part) * rest))),
        coloured_noise=tuple(map(float, np.sqrt(part * rest))),
        correlation_time=max(time, 1e-6),
    )


def choose_effects(
    case: Case, setup: CaseSetup, random: np.random.Generator
) -> tuple[list[ScalableEffect] | None, list[float]]:
    """Return the effects and their target sizes; None if one cannot be placed."""
    if case.kind in ("world", "correlated"):
        return [], []
    library = {"foreign": FOREIGN, "form": FORMS}.get(
        case.kind, CHANGED if case.changed else MISSING
    )
    if case.effect:
        names, targets = [case.effect], [case.size]
    elif case.kind == "six":
        names = [str(x) for x in random.choice(COMMON, 6)]
        targets = np.exp(random.uniform(*np.log(SIZES_OF_SIX), 6)).tolist()
    else:
        count = {"none": 0, "pair": 2, "triple": 3}[case.kind]
        names = [str(x) for x in random.choice(list(library), count, replace=False)]
        targets = [float(x) for x in random.choice(SIZES[:3], count)]
    if {"temperature_friction", "warm_up"} <= set(names):
        return None, []
    motion = reference_motion(setup, random)
    hidden = []
    for name in names:
        one = library[name](motion, int(random.integers(setup.arm.n)))
        if one is None or (name, one.joints) in {(each.effect, each.joints) for each in hidden}:
            return None, []
        hidden.append(one)
    return hidden, targets


def choose_world(case: Case, setup: CaseSetup, random: np.random.Generator) -> World:
    """Return the violated assumption of a case; one that violates nothing for other kinds."""
    if case.kind != "world":
        return World("")
    motion = reference_motion(setup, random)
    return WORLDS[case.effect](motion, int(random.integers(setup.arm.n)))


def reference_motion(setup: CaseSetup, random: np.random.Generator) -> ReferenceMotion:
    """Return the motion of the run on which sizes are defined."""
    plan = setup.plans[setup.counts]
    t = np.arange(0.0, plan.duration, 0.01)
    motion = move_along(setup.arm, t, *plan.at(t))
    return ReferenceMotion(
        setup.arm,
        torque_scale(setup.arm.robot),
        np.abs(motion.dq).max(axis=0),
        np.sqrt(np.mean(motion.dq**2, axis=0)),
        np.abs(motion.rigid).max(axis=0),
        motion.q.min(axis=0),
        motion.q.max(axis=0),
        plan.duration,
        float(setup.sensors.rate or 0.0),
        setup.thermal,
        random,
    )
