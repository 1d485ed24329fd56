"""The simulated arm: its true parameters, friction and hidden effects, and their torques."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from lieid_casadi.arrays import Array
from lieid_casadi.errors import EffectError
from lieid_casadi.plant.effects import (
    Armature,
    BaseTilt,
    ExternalWrench,
    HiddenEffect,
    JointEffect,
    JointElasticity,
    JointState,
    Payload,
    Presliding,
)
from lieid_casadi.robot import Robot
from lieid_casadi.robot.inertia import body_inertia, link_parameters, parameter_transport
from lieid_casadi.robot.pinocchio_model import TOOL_FRAME, build_pinocchio

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
    """A simulated arm. An effect on a joint that the robot does not have is an EffectError."""

    robot: Robot  # the description that users have: kinematics, limits and nominal inertias
    parameters: Array  # (10 n,), true link parameters without the payload of an effect
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
            gravity = Rotation.from_euler("xy", [tilt.about_x, tilt.about_y]).apply(gravity)
        return gravity

    @property
    def armature(self) -> Array:
        """Motor inertia per joint (n,), kg·m²."""
        own = self.effects_of(Armature)
        return self._summed([e.joint for e in own], [e.inertia for e in own])

    @property
    def compliance(self) -> Array:
        """Compliance per joint (n,), rad/(N·m); 0 where the joint is rigid."""
        own = self.effects_of(JointElasticity)
        return self._summed([e.joint for e in own], [1.0 / e.stiffness for e in own])

    def _summed(self, joints: list[int], values: list[float]) -> Array:
        total = np.zeros(self.n)
        np.add.at(total, joints, values)
        return total

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


LEAST_MOMENT = 1e-3  # of the largest principal second moment of mass


def perturbed_inertias(robot: Robot, *, spread: float = 0.2, seed: int) -> Array:
    """Return physically consistent link parameters (10 n,) near the nominal ones.

    Each mass is scaled by a uniform factor in 1 ± spread, each centre of mass moved by up to
    ``spread`` of its distance and of the body's radius of gyration, and the body stretched
    along its principal axes so that the second moments change by 1 ± spread. A description
    with a physically inconsistent body (flat or negative distribution of mass) is corrected first.
    """
    random = np.random.default_rng(seed)
    links = [_perturbed(link, spread, random) for link in robot.link_parameters.reshape(-1, 10)]
    return np.concatenate(links)


def with_payload(robot: Robot, parameters: Array, payload: Array) -> Array:
    """Return link parameters (10 n,) with a body (10,), in the tool's frame, added at the tool."""
    loaded = np.array(parameters, dtype=float)
    loaded[-10:] += parameter_transport(robot.tool) @ payload
    return loaded


def _perturbed(link: Array, spread: float, random: np.random.Generator) -> Array:
    mass_factor, stretch = 1.0 + spread * random.uniform(-1, 1), random.uniform(-1, 1, 3)
    shift = spread * random.uniform(-1, 1, 3)
    if link[0] <= 0.0:
        return link.copy()
    body = body_inertia(link)
    # Σ = ∫ r rᵀ dm about the centre of mass: positive definite for every physical body.
    second_moment = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia
    moments, axes = np.linalg.eigh(second_moment)
    moments = np.maximum(moments, LEAST_MOMENT * max(float(moments.max()), 1e-9))
    gyration = np.sqrt(moments.sum() / body.mass)
    com = body.com * (1.0 + shift) + 0.5 * shift[::-1] * gyration
    moments = moments * mass_factor * (1.0 + spread * stretch)
    sigma = axes @ np.diag(moments) @ axes.T
    return link_parameters(body.mass * mass_factor, com, np.trace(sigma) * np.eye(3) - sigma)


def rigid_torques(model: Any, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the rigid torques (N, n) of a ``pinocchio.Model`` along a path (N, n), N·m."""
    import pinocchio as pin

    tau: Array = pin.rneaInParallel(1, pin.ModelPool(model, 1), q.T, dq.T, ddq.T).T
    return tau


def wrench_torque(model: Any, data: Any, q: Array, wrench: Array) -> Array:
    """Return Jᵀ·F (n,) of a wrench [m; f] (6,) that the tool exerts at its origin, base axes."""
    import pinocchio as pin

    frame = model.getFrameId(TOOL_FRAME)
    jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    torque: Array = jacobian.T @ np.concatenate([wrench[3:], wrench[:3]])
    return torque


class Drive:
    """Friction and effects of an arm, prepared for many evaluations.

    Arrays are (n,) at one instant or (N, n) along a path. Only effects that define a term are
    evaluated for it.
    """

    def __init__(self, arm: Arm) -> None:
        effects = [e for e in arm.effects if isinstance(e, JointEffect)]
        self._friction = arm.friction
        terms = ("level", "level_slope", "level_scale", "viscous", "viscous_scale", "torque")
        self._defining = {term: [e for e in effects if hasattr(e, term)] for term in terms}
        self.hysteresis_width = np.zeros(arm.n)
        for effect in arm.effects_of(Presliding):
            self.hysteresis_width[effect.joint] = effect.width
        self.hysteretic = self.hysteresis_width > 0.0

    def _with(self, values: Array, s: JointState, term: str, scale: str = "") -> Array:
        """Return values (…, n) with what effects add to their joints, times their scales."""
        found = np.empty(s.dq.shape)
        found[...] = values
        for effect in self._defining[term] if term else ():
            found[..., effect.joint] += getattr(effect, term)(s)
        for effect in self._defining[scale] if scale else ():
            found[..., effect.joint] *= getattr(effect, scale)(s)
        return found

    def level(self, s: JointState) -> Array:
        """Level of dry friction (…, n) ≥ 0, N·m."""
        return np.maximum(self._with(self._friction.coulomb, s, "level", "level_scale"), 0.0)

    def level_slope(self, s: JointState) -> Array | None:
        """Derivative of the level by the load (…, n); None if it is zero everywhere."""
        if not self._defining["level_slope"]:
            return None
        return self._with(np.zeros(()), s, "level_slope", "level_scale")

    def damping(self, s: JointState) -> Array:
        """Linear viscous coefficient (…, n), N·m·s/rad."""
        return self._with(self._friction.viscous, s, "", "viscous_scale")

    def smooth(self, s: JointState) -> Array:
        """All torques except those of the rigid arm, armature and dry friction (…, n), N·m."""
        friction = self._with(self._friction.viscous * s.dq, s, "viscous", "viscous_scale")
        return self._with(friction + self._friction.offset, s, "torque")

    def next_hysteresis(self, z: Array, step: Array) -> Array:
        """Dahl's state (n,), −1…1, after the motor moved by ``step`` (n,); exact for any step."""
        direction = np.sign(step)
        left = np.exp(-np.abs(step) / np.where(self.hysteretic, self.hysteresis_width, 1.0))
        return np.where(self.hysteretic, direction + (z - direction) * left, 0.0)
