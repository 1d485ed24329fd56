"""The simulated arm: its true parameters, friction and hidden effects."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import EffectError
from lieid_casadi.plant.arm_effects import BaseTilt, ExternalWrench, Payload
from lieid_casadi.plant.effect import HiddenEffect
from lieid_casadi.plant.inertias import with_payload
from lieid_casadi.plant.joint_effects import Armature, JointElasticity
from lieid_casadi.plant.rigid import build_pinocchio
from lieid_casadi.robot import Robot
from lieid_casadi.robot.inertia import link_parameters

Array = NDArray[np.float64]
E = TypeVar("E", bound=HiddenEffect)


@dataclass(frozen=True, eq=False)
class JointFriction:
    """f_c·sgn(q̇) + f_v·q̇ + f_b per joint, (n,) each."""

    coulomb: Array
    viscous: Array
    offset: Array

    @classmethod
    def none(cls, n: int) -> JointFriction:
        """No friction at all."""
        return cls(np.zeros(n), np.zeros(n), np.zeros(n))


@dataclass(frozen=True)
class Thermal:
    """Each joint warms up from ``start`` by ``rise`` (°C), with a time constant in s."""

    start: float = 25.0
    rise: float = 0.0
    time_constant: float = 300.0

    def at(self, t: Array, n: int) -> Array:
        """Temperatures (N, n) at times (N,); the smaller joints near the tool warm up faster."""
        pace = 1.0 + 0.5 * np.arange(n) / max(n - 1, 1)
        warmed = 1.0 - np.exp(-np.maximum(t, 0.0)[:, None] * pace / self.time_constant)
        return np.asarray(self.start + self.rise * warmed)


@dataclass(frozen=True, eq=False)
class Arm:
    """A simulated arm.

    Attributes
    ----------
    robot
        Description that users have: kinematics, limits and nominal inertias.
    parameters : (10 n,)
        True link parameters, without the payload of an effect.
    effects
        Hidden effects.

    Raises
    ------
    EffectError
        An effect on a joint that the robot does not have.
    """

    robot: Robot
    parameters: Array
    friction: JointFriction
    effects: tuple[HiddenEffect, ...] = ()
    thermal: Thermal = field(default_factory=Thermal)

    def __post_init__(self) -> None:
        for effect in self.effects:
            for key in ("joint", "source"):
                joint = getattr(effect, key, 0) or 0  # None: every joint
                if not 0 <= joint < self.robot.n:
                    raise EffectError(
                        f"{effect.name}: {key} {joint} (from 0), but robot "
                        f"{self.robot.name!r} has {self.robot.n} joints"
                    )

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    def with_effects(self, *effects: HiddenEffect) -> Arm:
        """Return the same arm with more hidden effects."""
        return replace(self, effects=self.effects + effects)

    def effects_of(self, kind: type[E]) -> tuple[E, ...]:
        """Return the hidden effects of one kind."""
        return tuple(effect for effect in self.effects if isinstance(effect, kind))

    @property
    def loaded_parameters(self) -> Array:
        """True link parameters (10 n,), payloads on the last link included."""
        parameters = np.array(self.parameters, dtype=float)
        for load in self.effects_of(Payload):
            ball = 0.4 * load.mass * load.radius**2 * np.eye(3)
            body = link_parameters(load.mass, np.array(load.com), ball)
            parameters = with_payload(self.robot, parameters, body)
        return parameters

    @property
    def gravity(self) -> Array:
        """True gravity (3,) in the base frame, m/s²."""
        gravity = np.array(self.robot.gravity, dtype=float)
        for tilt in self.effects_of(BaseTilt):
            cx, sx, cy, sy = *_cos_sin(tilt.about_x), *_cos_sin(tilt.about_y)
            about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
            about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
            gravity = about_y @ about_x @ gravity
        return gravity

    @property
    def armature(self) -> Array:
        """Motor inertia per joint (n,), kg·m²."""
        inertia = np.zeros(self.n)
        for effect in self.effects_of(Armature):
            inertia[effect.joint] += effect.inertia
        return inertia

    @property
    def compliance(self) -> Array:
        """Compliance per joint (n,), rad/(N·m); 0 where the joint is rigid."""
        compliance = np.zeros(self.n)
        for effect in self.effects_of(JointElasticity):
            compliance[effect.joint] += 1.0 / effect.stiffness
        return compliance

    @property
    def tool_wrench(self) -> Array:
        """Wrench [m; f] (6,) that the tool exerts, base axes."""
        wrench = np.zeros(6)
        for effect in self.effects_of(ExternalWrench):
            wrench += np.array([*effect.moment, *effect.force])
        return wrench

    def rigid_model(self) -> Any:
        """Return the true rigid arm as ``pinocchio.Model``."""
        return build_pinocchio(self.robot, self.loaded_parameters, gravity=self.gravity)


def _cos_sin(angle: float) -> tuple[float, float]:
    return float(np.cos(angle)), float(np.sin(angle))
