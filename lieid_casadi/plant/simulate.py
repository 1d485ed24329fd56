"""Simulation of an arm under joint control, integrated at the control rate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import EffectError
from lieid_casadi.plant.arm import Arm
from lieid_casadi.plant.effects import EncoderOffset
from lieid_casadi.plant.ideal_tracking import TrueMotion
from lieid_casadi.plant.rigid import rigid_torques
from lieid_casadi.plant.sensors import Sensors, measure
from lieid_casadi.plant.stepper import DriveCommand, Stepper, motion_of
from lieid_casadi.plant.trajectories import ReferenceTrajectory, torque_scale
from lieid_casadi.recording import Recording
from lieid_casadi.robot.pinocchio_model import build_pinocchio

Progress = Callable[[float], None]

SETTLING = 0.5  # s at the start pose before the recording, until the controller is in balance
BANDWIDTH = 100.0  # rad/s, of each joint alone
#: Least stiffness in parts of the torque scale per radian (metre), by which light joints overcome
#: friction: friction of 4 % of the torque limit causes an error of 0.0004.
STIFFNESS = 100.0
REPORTS = 100


def simulate(
    arm: Arm,
    trajectory: ReferenceTrajectory,
    *,
    duration: float | None = None,
    rate: float = 1000.0,
    sensors: Sensors | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    name: str = "",
) -> Recording:
    """Simulate an arm that tracks a trajectory by joint control, and record it.

    Control is PD with the nominal rigid torques along the reference, critically damped at the least
    nominal inertia. ``rate`` (Hz) is that of control and integration. Sensors are ideal at 200 Hz
    by default; the seed is that of their noise. ``progress`` is called with the fraction done.

    RecordingError: sensors faster than ``rate``.
    """
    motion = move(arm, trajectory, duration=duration, rate=rate, progress=progress)
    return measure(arm, motion, sensors or Sensors(), seed=seed, name=name)


def move(
    arm: Arm,
    trajectory: ReferenceTrajectory,
    *,
    duration: float | None = None,
    rate: float = 1000.0,
    progress: Progress | None = None,
) -> TrueMotion:
    """Simulate an arm that tracks a trajectory; return true signals, one row per control period.

    Integration is by the drift-kick-drift rule: torques are evaluated at q + h/2·q̇ with the mean
    velocity of the step, and each row holds that instant, so that τ = rigid + effects to rounding.
    Stick and slip follow an implicit rule (friction takes any value up to its level that stops the
    joint), so that a joint at rest stays exactly at rest. Arguments are those of `simulate`.

    EffectError: elastic joints, which `measure_along` has.
    """
    span = trajectory.duration if duration is None else duration
    if arm.compliance.any():
        raise EffectError("joint_elasticity: not simulated under control; expected measure_along")
    settling = round(SETTLING * rate)
    t = np.arange(-settling, round(span * rate) + 1) / rate
    temperature = arm.thermal.at(t, arm.n)
    controller = _Controller(arm, trajectory, t)
    stepper = Stepper(arm, 1.0 / rate, controller.reference[0])
    steps = []
    every = max(1, t.size // REPORTS)
    for k in range(t.size):
        command = controller.command(k, stepper.q, stepper.dq)
        steps.append(stepper.step(t[k], command, temperature[k]))
        if progress is not None and k % every == 0:
            progress(k / t.size)
    if progress is not None:
        progress(1.0)
    return motion_of(steps[settling:], t[settling:], temperature[settling:])


class _Controller:
    """Torques of PD control, limited to what the drives can deliver."""

    def __init__(self, arm: Arm, trajectory: ReferenceTrajectory, t: Array) -> None:
        q, dq, ddq = trajectory.at(np.clip(t, 0.0, trajectory.duration))
        for effect in arm.effects_of(EncoderOffset):  # the controller uses the encoders
            q[:, effect.joint] += effect.offset
        self.reference = q
        self._goal, self._goal_velocity = (np.concatenate([x[1:], x[-1:]]) for x in (q, dq))
        model = build_pinocchio(arm.robot)
        self._feedforward = rigid_torques(model, q, dq, ddq)
        inertia = _least_inertia(model, q)
        self._stiffness = np.maximum(inertia * BANDWIDTH**2, STIFFNESS * torque_scale(arm.robot))
        self._damping = 2.0 * np.sqrt(self._stiffness * inertia)
        h = t[1] - t[0]
        self._h, self._gain = h, self._stiffness * 0.5 * h * h + self._damping * h
        limit = arm.robot.limit("torque")
        self._limit = np.where(np.isfinite(limit), limit, np.inf)

    def command(self, k: int, q: Array, dq: Array) -> DriveCommand:
        """Return the command for the step that starts at q, dq (n,)."""
        constant = (
            self._feedforward[k]
            + self._stiffness * (self._goal[k] - q - self._h * dq)
            + self._damping * (self._goal_velocity[k] - dq)
        )
        return DriveCommand(constant, self._gain, self._limit)


def _least_inertia(model: Any, path: Array) -> Array:
    """Return the least inertia of each joint along a path (n,), the other joints being free."""
    import pinocchio as pin

    data = model.createData()
    rows = path[np.linspace(0, len(path) - 1, 50).astype(int)]
    inverses = [np.diag(np.linalg.inv(pin.crba(model, data, q))) for q in rows]
    least: Array = np.reciprocal(np.max(inverses, axis=0))
    return least
