"""A hidden effect whose strength is scaled, and the motion from which its limits are derived."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.plant import Arm, HiddenEffect, Thermal

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ReferenceMotion:
    """The arm without hidden effects and its motion, from which limits are derived; (n,) arrays."""

    arm: Arm
    torque: Array  # that the drives can deliver, N·m
    speed: Array  # largest on the motion
    rms_speed: Array
    load: Array  # largest rigid torque on the motion
    lower: Array  # least angle on the motion
    upper: Array
    duration: float
    rate: float
    thermal: tuple[Thermal, ...]
    random: np.random.Generator

    @property
    def n(self) -> int:
        return self.arm.n

    def sign(self) -> float:
        return float(self.random.choice([-1.0, 1.0]))

    def angle(self) -> float:
        return float(self.random.uniform(-np.pi, np.pi))

    def log(self, lower: float, upper: float) -> float:
        return float(np.exp(self.random.uniform(np.log(lower), np.log(upper))))

    def revolute(self, joint: int) -> bool:
        return self.arm.robot.joints[joint].revolute

    def direction(self, size: int) -> Array:
        v = self.random.standard_normal(size)
        return v / np.linalg.norm(v)

    def warmest(self) -> float:
        """Return the largest deviation of a joint temperature from 25 °C."""
        return max(abs(t.start - 25.0) + t.rise for t in self.thermal)


@dataclass(frozen=True, eq=False)
class ScalableEffect:
    """One hidden effect.

    Attributes
    ----------
    effect, joints
        Name and joints (from 0) as a diagnosis should give them.
    hide
        Arm, strength, run (0 or 1: training and test, or before and after) → arm with the effect.
    most, least
        Largest realistic strength, and the smallest that a recording resolves. If both are equal,
        the noise is scaled instead of the strength.
    signals
        For effects that no library has: the signals that the unexplained part depends on.
    accepted
        For forms that no library has: the effects of the same class, any of which is right.
    simulated
        Whether it can be simulated with a controller; not if it needs the whole path.
    elastic
        Whether it needs a smooth motion of the links that is tracked exactly.
    """

    effect: str
    joints: tuple[int, ...]
    hide: Callable[[Arm, float, int], Arm]
    most: float
    signals: tuple[str, ...] = ()
    simulated: bool = True
    details: str = ""
    least: float = 0.0
    elastic: bool = False
    accepted: tuple[str, ...] = ()

    @property
    def fixed(self) -> bool:
        """Whether the strength is given and the noise is scaled."""
        return self.least == self.most


EffectFactory = Callable[[ReferenceMotion, int], ScalableEffect | None]


def with_effect(make: Callable[[float], HiddenEffect]) -> Callable[[Arm, float, int], Arm]:
    """Return a ``hide`` that adds the effect made with a strength."""
    return lambda arm, strength, run: arm.with_effects(make(strength))
