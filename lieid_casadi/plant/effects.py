"""Hidden effects of the plant: on the torque of a joint, on the whole arm, on what is measured.

Nothing here comes from ``lieid_casadi.effects``, so that an error in one is not repeated in the
other. Each effect has the name of the library's effect, so that a diagnosis can be scored.
"""

# ruff: noqa: D102

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lieid_casadi.arrays import Array


@dataclass(slots=True)
class JointState:
    """Quantities that joint torques depend on: (n,) in a simulation, (N, n) along a path."""

    t: Array  # () or (N,), s
    q: Array  # of the motor (of the link, where the joint is rigid)
    dq: Array
    sign: Array  # direction of motion: −1, 0 at rest, 1
    load: Array  # rigid torque, payload included; armature and friction not, N·m
    temperature: Array  # °C


@dataclass(frozen=True)
class HiddenEffect:
    """An effect of the plant; its name is that of its class in lower case with underscores."""

    name: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        if "name" not in vars(cls):
            cls.name = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()


@dataclass(frozen=True)
class JointEffect(HiddenEffect):
    """An effect on the torque of one joint (from 0).

    The drive's torque is rigid + armature·q̈ + ``torque``
    + ``viscous_scale``·(f_v·q̇ + ``viscous``) + dry friction, where dry friction is
    sgn(q̇)·``level_scale``·(f_c + ``level``) in motion; at rest it takes the value that keeps the
    joint at rest, up to that level. Subclasses define those of these methods, of a `JointState`,
    that they change; with ``level`` its derivative by the load, ``level_slope``.
    """

    joint: int


SLOWEST = 1e-12  # rad/s: keeps |τ|/|q̇| finite at rest


@dataclass(frozen=True)
class ViscousPolynomial(JointEffect):
    """f2·sgn(q̇)·q̇² + f3·q̇³."""

    quadratic: float = 0.0
    cubic: float = 0.0

    def viscous(self, s: JointState) -> Array:
        dq = s.dq[..., self.joint]
        return (self.quadratic * np.abs(dq) + self.cubic * dq * dq) * dq


@dataclass(frozen=True)
class ViscousAsymmetric(JointEffect):
    """f·|q̇|: different viscous coefficients forward and backward."""

    coefficient: float = 0.0

    def viscous(self, s: JointState) -> Array:
        return self.coefficient * np.abs(s.dq[..., self.joint])


@dataclass(frozen=True)
class Stribeck(JointEffect):
    """Dry friction that is larger by ``extra`` (N·m) at rest: extra·exp(−(q̇/velocity)²)."""

    extra: float = 0.0
    velocity: float = 0.1

    def level(self, s: JointState) -> Array:
        ratio = s.dq[..., self.joint] / self.velocity
        return np.asarray(self.extra * np.exp(-ratio * ratio))


@dataclass(frozen=True)
class LoadFriction(JointEffect):
    """Dry friction that grows with the load: f·|τ| + f1·exp(−f2·|τ|/|q̇|)."""

    gain: float = 0.0
    extra: float = 0.0
    rate: float = 0.0

    def level(self, s: JointState) -> Array:
        load, speed = np.abs(s.load[..., self.joint]), np.abs(s.dq[..., self.joint])
        level = self.gain * load
        if self.extra:
            level = level + self.extra * np.exp(-self.rate * load / np.maximum(speed, SLOWEST))
        return level

    def level_slope(self, s: JointState) -> Array:
        load, speed = s.load[..., self.joint], np.abs(s.dq[..., self.joint])
        slope = np.asarray(self.gain)
        if self.extra:
            rate = self.rate / np.maximum(speed, SLOWEST)
            slope = slope - self.extra * rate * np.exp(-rate * np.abs(load))
        return slope * np.sign(load)


@dataclass(frozen=True)
class TemperatureFriction(JointEffect):
    """Friction that decreases when warm: f_v·exp(−decay·(T − T̄)), f_c·(1 − slope·(T − T̄))."""

    viscous_decay: float = 0.0
    dry_slope: float = 0.0
    reference: float = 25.0

    def viscous_scale(self, s: JointState) -> Array:
        warmer = s.temperature[..., self.joint] - self.reference
        return np.asarray(np.exp(-self.viscous_decay * warmer))

    def level_scale(self, s: JointState) -> Array:
        return 1.0 - self.dry_slope * (s.temperature[..., self.joint] - self.reference)


@dataclass(frozen=True)
class WarmUp(JointEffect):
    """Friction × (1 + change·(1 − exp(−t/time_constant)))."""

    change: float = -0.3
    time_constant: float = 30.0

    def viscous_scale(self, s: JointState) -> Array:
        return 1.0 + self.change * (1.0 - np.exp(-s.t / self.time_constant))

    level_scale = viscous_scale


@dataclass(frozen=True)
class PositionFriction(JointEffect):
    """Dry friction that varies with the position: amplitude·sin(harmonic·q + phase)."""

    amplitude: float = 0.0
    harmonic: float = 1.0
    phase: float = 0.0

    def level(self, s: JointState) -> Array:
        return self.amplitude * np.sin(self.harmonic * s.q[..., self.joint] + self.phase)


@dataclass(frozen=True)
class Presliding(HiddenEffect):
    """Dahl's hysteresis in place of the sign in dry friction, with the width ``width`` (rad)."""

    joint: int
    width: float = 0.01


@dataclass(frozen=True)
class Armature(HiddenEffect):
    """I·q̈ of the motor's rotor, kg·m² at the joint."""

    joint: int
    inertia: float = 0.0


@dataclass(frozen=True)
class TorqueRipple(JointEffect):
    """amplitude·sin(k·q + phase)."""

    amplitude: float = 0.0
    harmonic: float = 2.0
    phase: float = 0.0

    def torque(self, s: JointState) -> Array:
        return self.amplitude * np.sin(self.harmonic * s.q[..., self.joint] + self.phase)


@dataclass(frozen=True)
class PositionSpring(JointEffect):
    """stiffness·(q − rest): balancer, hose, cable."""

    stiffness: float = 0.0
    rest: float = 0.0

    def torque(self, s: JointState) -> Array:
        return self.stiffness * (s.q[..., self.joint] - self.rest)


@dataclass(frozen=True)
class TransmissionCoupling(JointEffect):
    """Friction on this joint from the motion of joint ``source`` in a shared gear."""

    source: int = 0
    viscous_coefficient: float = 0.0
    coulomb: float = 0.0

    def torque(self, s: JointState) -> Array:
        dq, sign = s.dq[..., self.source], s.sign[..., self.source]
        return self.viscous_coefficient * dq + self.coulomb * sign


@dataclass(frozen=True)
class JointElasticity(HiddenEffect):
    """The measured motor angle leads the link by (rigid torque)/stiffness, N·m/rad."""

    joint: int
    stiffness: float = 1e4


@dataclass(frozen=True)
class ForeignTorque(JointEffect):
    """Any torque; ``function`` must work on (n,) and on (N, n) arrays (index ``[..., joint]``)."""

    name: ClassVar[str] = "foreign"
    function: Callable[[JointState], Array] = lambda s: np.zeros(())

    def torque(self, s: JointState) -> Array:
        return np.asarray(self.function(s))


@dataclass(frozen=True)
class BaseTilt(HiddenEffect):
    """A tilted base: gravity rotated about the base's x, then y axis, rad."""

    about_x: float = 0.0
    about_y: float = 0.0


@dataclass(frozen=True)
class Payload(HiddenEffect):
    """A ball of ``radius`` (m) and ``mass`` (kg) at ``com`` (m) in the tool's frame."""

    mass: float = 0.0
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: float = 0.03


@dataclass(frozen=True)
class ExternalWrench(HiddenEffect):
    """A constant wrench that the tool exerts at its origin, in base axes; N·m and N."""

    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class TorqueGain(HiddenEffect):
    """τ_measured = (1 + gain)·τ."""

    joint: int
    gain: float = 0.0


@dataclass(frozen=True)
class TorqueDelay(HiddenEffect):
    """τ_measured(t) = τ(t − delay), s."""

    joint: int
    delay: float = 0.0


@dataclass(frozen=True)
class TimeShift(HiddenEffect):
    """τ_measured(t) = τ(t − delay) on every joint, s."""

    delay: float = 0.0


@dataclass(frozen=True)
class TorqueLowpass(HiddenEffect):
    """A filter of ``order`` first-order stages, time constant in s; on every joint for None."""

    joint: int | None = None
    time_constant: float = 0.0
    order: int = 1


@dataclass(frozen=True)
class BiasDrift(HiddenEffect):
    """τ_measured = τ + rate·(t − t̄), N·m/s."""

    joint: int
    rate: float = 0.0


@dataclass(frozen=True)
class EncoderOffset(HiddenEffect):
    """q_true = q_measured + offset, rad."""

    joint: int
    offset: float = 0.0
