"""Simulation of an arm under joint control, integrated at the control rate."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import EffectError
from lieid_casadi.plant.arm import Arm
from lieid_casadi.plant.effects import EncoderOffset
from lieid_casadi.plant.ideal_tracking import TrueMotion, move_along
from lieid_casadi.plant.rigid import build_pinocchio, rigid_torques
from lieid_casadi.plant.sensors import Sensors, measure
from lieid_casadi.plant.stepper import DriveCommand, Stepper, motion_of
from lieid_casadi.plant.trajectories import ReferenceTrajectory, torque_scale
from lieid_casadi.recording import Recording

Progress = Callable[[float], None]

logger = logging.getLogger("lieid_casadi")

SETTLING = 0.5  # s at the start pose before the recording, until the controller is in balance
ELASTIC_BANDWIDTH = 20.0  # Hz, of the links of an elastic arm
REPORTS = 100


@dataclass(frozen=True)
class Control:
    """Joint PD control with the nominal model, critically damped at the least nominal inertia.

    ``feedforward`` adds nominal rigid torques along the reference, otherwise gravity at the actual
    pose. The least stiffness, in parts of the torque scale per radian (metre), lets light joints
    overcome friction: with 100, friction of 4 % of the torque limit causes an error of 0.0004.
    """

    bandwidth: float = 100.0  # rad/s, of each joint alone
    stiffness: float = 100.0
    feedforward: bool = True


def simulate(
    arm: Arm,
    trajectory: ReferenceTrajectory,
    *,
    duration: float | None = None,
    rate: float = 1000.0,
    sensors: Sensors | None = None,
    control: Control | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    name: str = "",
) -> Recording:
    """Simulate an arm that tracks a trajectory and record it.

    The duration (s) is that of the trajectory by default; ``rate`` (Hz) is that of control and
    integration. Sensors are ideal at 200 Hz by default; the seed is that of their noise.
    ``progress`` is called with the fraction that is done, 0 to 1.

    EffectError: presliding too stiff for this rate; RecordingError: sensors faster than it.
    """
    motion = move(arm, trajectory, duration=duration, rate=rate, control=control, progress=progress)
    return measure(arm, motion, sensors or Sensors(), seed=seed, name=name)


def move(
    arm: Arm,
    trajectory: ReferenceTrajectory,
    *,
    duration: float | None = None,
    rate: float = 1000.0,
    control: Control | None = None,
    progress: Progress | None = None,
) -> TrueMotion:
    """Simulate an arm that tracks a trajectory; return true signals, one row per control period.

    Integration is by the drift-kick-drift rule: torques are evaluated at q + h/2·q̇ with the mean
    velocity of the step, and each row holds that instant, so that τ = rigid + effects to rounding.
    Stick and slip follow an implicit rule (friction takes any value up to its level that stops the
    joint), so that a joint at rest stays exactly at rest.

    With elastic joints the links follow the path of the rigid arm, smoothed to 20 Hz; motion of the
    motors and torques follow from this path. Arguments are those of `simulate`.

    EffectError: presliding too stiff for this rate.
    """
    span = trajectory.duration if duration is None else duration
    settling = round(SETTLING * rate)
    last = settling + round(span * rate)
    elastic = bool(arm.compliance.any())
    # The path of an elastic arm is filtered; the ends of the filter are not recorded.
    t = np.arange(-settling, last + 1 - settling + elastic * settling) / rate
    temperature = arm.thermal.at(t, arm.n)
    controller = _Controller(arm, trajectory, t, control or Control())
    stepper = Stepper(arm, 1.0 / rate, controller.reference[0])
    _check_presliding(arm, stepper, controller.inertia, 1.0 / rate)
    steps = []
    every = max(1, t.size // REPORTS)
    for k in range(t.size):
        command = controller.command(k, stepper.q, stepper.dq)
        steps.append(stepper.step(t[k], command, temperature[k]))
        if progress is not None and k % every == 0:
            progress(k / t.size)
    if stepper.unsettled:
        logger.debug("%d of %d steps did not settle stick and slip", stepper.unsettled, t.size)
    recorded = slice(settling, last + 1)
    if elastic:
        motion = _elastic(arm, t, np.array([step.q for step in steps]), recorded)
    else:
        motion = motion_of(steps[recorded], t[recorded], temperature[recorded])
    if progress is not None:
        progress(1.0)
    return motion


class _Controller:
    """Torques of PD control, limited to what the drives can deliver."""

    def __init__(
        self, arm: Arm, trajectory: ReferenceTrajectory, t: Array, control: Control
    ) -> None:
        q, dq, ddq = trajectory.at(np.clip(t, 0.0, trajectory.duration))
        for effect in arm.effects_of(EncoderOffset):  # the controller uses the encoders
            q[:, effect.joint] += effect.offset
        self.reference = q
        self._goal, self._goal_velocity = (np.concatenate([x[1:], x[-1:]]) for x in (q, dq))
        self._model = build_pinocchio(arm.robot)
        self._data = self._model.createData()
        self._feedforward = rigid_torques(self._model, q, dq, ddq) if control.feedforward else None
        self.inertia = _least_inertia(self._model, q)
        self._stiffness = np.maximum(
            self.inertia * control.bandwidth**2, control.stiffness * torque_scale(arm.robot)
        )
        self._damping = 2.0 * np.sqrt(self._stiffness * self.inertia)
        h = t[1] - t[0]
        self._h, self._gain = h, self._stiffness * 0.5 * h * h + self._damping * h
        limit = arm.robot.limit("torque")
        self._limit = np.where(np.isfinite(limit), limit, np.inf)

    def command(self, k: int, q: Array, dq: Array) -> DriveCommand:
        """Return the command for the step that starts at q, dq (n,)."""
        import pinocchio as pin

        if self._feedforward is None:
            model = pin.computeGeneralizedGravity(self._model, self._data, q)
        else:
            model = self._feedforward[k]
        constant = (
            model
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


def _check_presliding(arm: Arm, stepper: Stepper, inertia: Array, h: float) -> None:
    stiffness = stepper.presliding_stiffness()
    for joint in np.flatnonzero(stiffness * h * h > inertia + arm.armature):
        rate = np.sqrt(stiffness[joint] / (inertia[joint] + arm.armature[joint]))
        raise EffectError(
            f"presliding on joint {joint + 1}: too stiff for control at {1.0 / h:g} Hz; "
            f"expected a larger width, or a rate of at least {rate:.0f} Hz"
        )


def _elastic(arm: Arm, t: Array, q: Array, recorded: slice) -> TrueMotion:
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, sosfiltfilt

    sos = butter(4, ELASTIC_BANDWIDTH, fs=1.0 / (t[1] - t[0]), output="sos")
    path = CubicSpline(t, sosfiltfilt(sos, q, axis=0))
    t = t[recorded]
    return move_along(arm, t, path(t), path(t, 1), path(t, 2))
