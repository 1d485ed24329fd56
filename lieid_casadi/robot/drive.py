"""Position-controlled drives: the torque that their control law states, and presets of servos."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from lieid_casadi.errors import RobotError

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Control law of one joint: τ = clip(clip(K·(q_cmd − q) − D_v·q̇, ±L_p) − D·q̇, ±L).

    A servo with duty = clip(P·(q_cmd − q) − P_v·q̇, ±d) and torque k_t/R·(V·duty − k_e·q̇) has
    K = k_t·V·P/R, D_v = k_t·V·P_v/R, D = k_t·k_e/R and L_p = k_t·V·d/R.

    Attributes
    ----------
    stiffness : float
        K, N·m/rad (sliding joints: N/m). If it is unknown, 1, or relative to that of joint 1:
        torques are then in units of K.
    damping : float
        D, N·m·s/rad; with unknown stiffness D/K, s.
    proportional_limit : float
        L_p, N·m: limit of what the controller asks for, K·(q_cmd − q) − D_v·q̇.
    torque_limit : float
        L, N·m: limit of the torque.
    relative : bool
        Whether the stiffness is unknown.
    servo : str
        Name of the preset that the numbers are from; empty otherwise.
    derivative : float
        D_v, N·m·s/rad: the controller's gain on velocity, within its limit L_p. Without the limit
        it is equal to D.
    """

    stiffness: float
    damping: float = 0.0
    proportional_limit: float = math.inf
    torque_limit: float = math.inf
    relative: bool = False
    servo: str = ""
    derivative: float = 0.0

    def torque(
        self, error: Any, velocity: Any, *, clip: Callable[[Any, float, float], Any] = np.clip
    ) -> Any:
        """Return the torque of the law (N,), N·m; rad if the stiffness is unknown.

        ``error`` (N,) is q_cmd − q in rad, ``velocity`` (N,) q̇ in rad/s, numbers or symbols;
        ``clip`` takes a value, its lower and its upper bound.
        """
        part = self.stiffness * error - self.derivative * velocity
        if math.isfinite(self.proportional_limit):
            part = clip(part, -self.proportional_limit, self.proportional_limit)
        torque = part - self.damping * velocity
        if math.isfinite(self.torque_limit):
            torque = clip(torque, -self.torque_limit, self.torque_limit)
        return torque

    def effective_error(
        self, error: Any, velocity: Any, *, clip: Callable[[Any, float, float], Any] = np.clip
    ) -> Any:
        """Return the position error (N,), rad, of that torque by the law without limits and D_v."""
        torque = self.torque(error, velocity, clip=clip)
        return (torque + self.damping * velocity) / self.stiffness

    def limited(self, torque_limit: float) -> Drive:
        """Return the law with a joint's torque limit, N·m (NaN: none); a servo has its own."""
        if math.isnan(torque_limit) or self.relative or math.isfinite(self.proportional_limit):
            return self
        return replace(self, torque_limit=min(torque_limit, self.torque_limit))

    def saturated(self, error: float) -> Drive:
        """Return the law with what the controller asks for limited to that of an error, rad."""
        limit = min(self.proportional_limit, self.stiffness * error)
        return replace(self, proportional_limit=limit)

    def scaled(self, stiffness: float) -> Drive:
        """Return a law of unknown stiffness with a stiffness, N·m/rad, that became known."""
        own = self.relative_to(stiffness)
        return replace(own, relative=False)

    def relative_to(self, ratio: float) -> Drive:
        """Return a law of unknown stiffness with K and its damping times a ratio."""
        return replace(
            self,
            stiffness=ratio * self.stiffness,
            damping=ratio * self.damping,
            derivative=ratio * self.derivative,
        )


def commanded_torque(drives: Sequence[Drive], error: Array, velocity: Array) -> Array:
    """Return the torque (N, n) of the control laws of all joints, N·m."""
    columns = [d.torque(error[:, j], velocity[:, j]) for j, d in enumerate(drives)]
    return np.stack(columns, axis=1)


def servo_drive(name: str, *, derivative: float = 0.0) -> Drive:
    """Return the control law of a servo preset.

    Parameters
    ----------
    name : str
        Such as ``sts3215``; the sources of the numbers are in ``robot/data/servos.yaml``.
    derivative : float
        Gain of the servo's controller on velocity (its D coefficient), N·m·s/rad.

    Raises
    ------
    RobotError
        No preset of that name.
    """
    presets = servo_presets()
    if name not in presets:
        raise RobotError(f"servo {name!r}: expected one of {', '.join(presets)}")
    servo = presets[name]
    stall, duty = servo["stall_torque"], servo["largest_duty"]
    return Drive(
        stiffness=stall * servo["gain"],
        damping=stall / servo["no_load_speed"],
        proportional_limit=stall * duty,
        servo=name,
        derivative=derivative,
    )


@cache
def servo_presets() -> dict[str, dict[str, Any]]:
    """Return the numbers of the presets by name; the file names their sources."""
    file = resources.files("lieid_casadi.robot").joinpath("data", "servos.yaml")
    presets: dict[str, dict[str, Any]] = yaml.safe_load(file.read_text("utf-8"))
    return presets
