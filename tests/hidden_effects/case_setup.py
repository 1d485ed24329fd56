"""Arm, motions and sensors of a case, and the effects to hide, all drawn from its name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from hidden_effects.arms import ARMS, load_arm
from hidden_effects.effect_library import CHANGED, MISSING
from hidden_effects.foreign import FOREIGN
from hidden_effects.motions import draw_motion
from hidden_effects.scalable_effect import ReferenceMotion, ScalableEffect
from numpy.typing import NDArray

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

Array = NDArray[np.float64]
LEAST_NOISE, MOST_NOISE = 1e-4, 1.5e-2  # relative to the torque that the drives can deliver
SIZES = (5.0, 2.0, 1.0, 0.5)


@dataclass(frozen=True)
class Case:
    """One case of the benchmark, defined by its name.

    Attributes
    ----------
    kind
        ``none``, ``single``, ``pair``, ``triple``, ``foreign``.
    changed
        Whether effects changed since a fit; otherwise the model lacks them.
    effect
        For single and foreign effects; otherwise drawn.
    size
        For single and foreign effects; otherwise drawn from 5, 2, 1. In multiples of the noise.
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
class CaseSetup:
    """An arm without hidden effects, its motions and its sensors."""

    arm_name: str
    arm: Arm
    plans: tuple[ReferenceTrajectory, ReferenceTrajectory]
    kinds: tuple[str, str]
    thermal: tuple[Thermal, Thermal]
    sensors: Sensors
    noise: Array
    simulated: bool
    changed: bool

    @property
    def counts(self) -> int:
        """The run on which sizes are defined: training, or after the change."""
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
    duration = float(random.uniform(28.0, 36.0))
    kinds = (
        str(random.choice(["fourier", "fourier", "mixture", "poses"])),
        str(random.choice(["fourier", "mixture", "poses"])),
    )
    plans = tuple(draw_motion(robot, kind, duration, random) for kind in kinds)
    sensors, noise = _sensors(robot, scale * noise_factor, speed, random)
    return CaseSetup(
        arm_name, Arm(robot, parameters, friction), (plans[0], plans[1]), kinds,
        _thermal(case, random), sensors, noise, bool(random.random() < 0.2), case.changed,
    )  # fmt: skip


def _thermal(case: Case, random: np.random.Generator) -> tuple[Thermal, Thermal]:
    def thermal() -> Thermal:
        return Thermal(
            start=25.0 + random.uniform(0.0, 6.0),
            rise=random.uniform(6.0, 15.0),
            time_constant=random.uniform(8.0, 30.0),
        )

    first, second = thermal(), thermal()
    if case.changed:  # before the change the temperature is nearly constant
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


def choose_effects(
    case: Case, setup: CaseSetup, random: np.random.Generator
) -> tuple[list[ScalableEffect] | None, list[float]]:
    """Return the effects and their target sizes; None if one cannot be placed."""
    library = CHANGED if case.changed else MISSING
    count = {"none": 0, "single": 1, "foreign": 1, "pair": 2, "triple": 3}[case.kind]
    if case.kind in ("single", "foreign"):
        names, targets = [case.effect], [case.size]
    else:
        names = [str(x) for x in random.choice(list(library), count, replace=False)]
        targets = [float(x) for x in random.choice(SIZES[:3], count)]
    if {"temperature_friction", "warm_up"} <= set(names):
        return None, []
    plan = setup.plans[setup.counts]
    t = np.arange(0.0, plan.duration, 0.01)
    motion = move_along(setup.arm, t, *plan.at(t))
    ground = ReferenceMotion(
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
    hidden = []
    for name in names:
        make = FOREIGN[name] if case.kind == "foreign" else library[name]
        one = make(ground, int(random.integers(setup.arm.n)))
        if one is None:
            return None, []
        hidden.append(one)
    return hidden, targets
