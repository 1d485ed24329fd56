"""Hidden effects on the whole arm and on what is measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lieid_casadi.plant.effect import HiddenEffect


@dataclass(frozen=True)
class BaseTilt(HiddenEffect):
    """A tilted base: gravity rotated about the base's x, then y axis, rad."""

    name: ClassVar[str] = "base_tilt"
    about_x: float = 0.0
    about_y: float = 0.0


@dataclass(frozen=True)
class Payload(HiddenEffect):
    """A ball of ``radius`` (m) and ``mass`` (kg) at ``com`` (m) in the tool's frame."""

    name: ClassVar[str] = "payload"
    mass: float = 0.0
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: float = 0.03


@dataclass(frozen=True)
class ExternalWrench(HiddenEffect):
    """A constant wrench that the tool exerts at its origin, in base axes; N·m and N."""

    name: ClassVar[str] = "external_wrench"
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class TorqueGain(HiddenEffect):
    """τ_measured = (1 + gain)·τ."""

    name: ClassVar[str] = "torque_gain"
    joint: int
    gain: float = 0.0


@dataclass(frozen=True)
class TorqueDelay(HiddenEffect):
    """τ_measured(t) = τ(t − delay), s."""

    name: ClassVar[str] = "torque_delay"
    joint: int
    delay: float = 0.0


@dataclass(frozen=True)
class TimeShift(HiddenEffect):
    """τ_measured(t) = τ(t − delay) on every joint, s."""

    name: ClassVar[str] = "time_shift"
    delay: float = 0.0


@dataclass(frozen=True)
class TorqueLowpass(HiddenEffect):
    """A filter of ``order`` first-order stages, time constant in s; on every joint for None."""

    name: ClassVar[str] = "torque_lowpass"
    joint: int | None = None
    time_constant: float = 0.0
    order: int = 1


@dataclass(frozen=True)
class BiasDrift(HiddenEffect):
    """τ_measured = τ + rate·(t − t̄), N·m/s."""

    name: ClassVar[str] = "bias_drift"
    joint: int
    rate: float = 0.0


@dataclass(frozen=True)
class EncoderOffset(HiddenEffect):
    """q_true = q_measured + offset, rad."""

    name: ClassVar[str] = "encoder_offset"
    joint: int
    offset: float = 0.0
