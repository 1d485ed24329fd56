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

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.errors import RobotError


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
    overload, overload_time, protective_limit : float
        Overload protection: after the controller has asked for more than ``overload``, N·m, for
        ``overload_time``, s, the torque is limited to ``protective_limit``, N·m.
    """

    stiffness: float
    damping: float = 0.0
    proportional_limit: float = math.inf
    torque_limit: float = math.inf
    relative: bool = False
    servo: str = ""
    derivative: float = 0.0
    overload: float = math.inf
    overload_time: float = 0.0
    protective_limit: float = math.inf

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
        return (self.torque(error, velocity, clip=clip) + self.damping * velocity) / self.stiffness

    def protected(self, t: Array, error: Array, velocity: Array) -> Mask:
        """Return whether (N,) overload protection lowers the torque of the law at times t, s.

        ``error`` and ``velocity`` are as of `torque`. It acts until the controller asks for less
        than the lower limit allows.
        """
        asked = np.abs(self.stiffness * error - self.derivative * velocity)
        above, inside = asked > self.overload, asked > self.protective_limit
        since = np.maximum.accumulate(np.where(above, t[0], t))
        tripped = np.cumsum(above & (t - since >= self.overload_time))
        return np.asarray(inside & (tripped > np.maximum.accumulate(np.where(inside, 0, tripped))))

    def limited(self, torque_limit: float) -> Drive:
        """Return the law with a joint's torque limit, N·m (NaN: none); a servo has its own."""
        if math.isnan(torque_limit) or self.relative or math.isfinite(self.proportional_limit):
            return self
        return replace(self, torque_limit=min(torque_limit, self.torque_limit))

    def saturated(self, error: float) -> Drive:
        """Return the law with what the controller asks for limited to that of an error, rad."""
        limit = min(self.proportional_limit, self.stiffness * error)
        return replace(self, proportional_limit=limit)

    def relative_to(self, ratio: float) -> Drive:
        """Return a law of unknown stiffness with K, its damping and its limits times a ratio."""
        scaled = ("stiffness", "damping", "derivative", "proportional_limit", "torque_limit")
        return replace(self, **{name: ratio * getattr(self, name) for name in scaled})


def commanded_torque(drives: Sequence[Drive], t: Array, error: Array, velocity: Array) -> Array:
    """Return the torque (N, n) of the control laws of all joints at t (N,), N·m."""
    torque = np.empty_like(error)
    for j, law in enumerate(drives):
        signals = error[:, j], velocity[:, j]
        lowered = replace(law, proportional_limit=min(law.proportional_limit, law.protective_limit))
        torque[:, j] = np.where(
            law.protected(t, *signals), lowered.torque(*signals), law.torque(*signals)
        )
    return torque


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
    overload = servo.get("overload", {"duty": math.inf, "time": 0.0, "duty_after": math.inf})
    return Drive(
        stiffness=stall * servo["gain"],
        damping=stall / servo["no_load_speed"],
        proportional_limit=stall * duty,
        servo=name,
        derivative=derivative,
        overload=stall * overload["duty"],
        overload_time=overload["time"],
        protective_limit=stall * overload["duty_after"],
    )


@cache
def servo_presets() -> dict[str, dict[str, Any]]:
    """Return the numbers of the presets by name; the file names their sources."""
    file = resources.files("lieid_casadi.robot").joinpath("data", "servos.yaml")
    presets: dict[str, dict[str, Any]] = yaml.safe_load(file.read_text("utf-8"))
    return presets
