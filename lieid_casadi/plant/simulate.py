"""Simulation of an arm under joint control, integrated at the control rate.

The time step has rigid dynamics, effects, and dry friction with stick and slip.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.errors import EffectError
from lieid_casadi.plant.arm import Arm, Drive, rigid_torques, wrench_torque
from lieid_casadi.plant.effects import EncoderOffset, JointState
from lieid_casadi.plant.ideal_tracking import TrueMotion
from lieid_casadi.plant.sensors import Sensors, measure
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


MAX_ITERATIONS = 30
MAX_CHANGES = 4  # of one joint between stick and slip within a step
TOLERANCE = 1e-10  # N·m, relative to the torques at hand


@dataclass(slots=True)
class DriveCommand:
    """Torque of the drives within a step, (n,) each: constant − gain·a, saturated at ±limit.

    The gain represents a drive whose own loop is much faster than the step and reacts to the
    acceleration a of the step.
    """

    constant: Array
    gain: Array
    limit: Array

    def torque(self, a: Array) -> Array:
        """Torque (n,) at an acceleration (n,)."""
        return np.minimum(np.maximum(self.constant - self.gain * a, -self.limit), self.limit)


@dataclass(slots=True)
class StepResult:
    """The instant in the middle of a step, (n,) each; see ``TrueMotion``."""

    q: Array
    dq: Array
    ddq: Array
    tau: Array
    rigid: Array
    smooth: Array
    dry: Array
    resting: Mask


def motion_of(steps: Sequence[StepResult], t: Array, temperature: Array) -> TrueMotion:
    """Return the motion of a rigid arm from its steps at times (N,), with temperatures (N, n)."""
    q, dq, ddq, *torques, resting = (
        np.array([getattr(step, field.name) for step in steps]) for field in fields(StepResult)
    )
    tau, rigid, smooth, dry = torques
    return TrueMotion(t, q, dq, ddq, q, dq, ddq, tau, rigid, dry, smooth, resting, temperature)


class Stepper:
    """State (``q``, ``dq``) of an arm, integrated by the drift-kick-drift rule.

    q̄ = q + h/2·q̇;  q̇ ← q̇ + h·a;  q ← q̄ + h/2·q̇, where a solves

        M(q̄)·a + b(q̄, v̄) + smooth(q̄, v̄) + armature·a + dry = τ,   v̄ = q̇ + h/2·a.

    Each joint either slips, dry = ±level with the sign of its velocity after the step, or
    sticks: velocity 0 after the step, |dry| ≤ level. Newton's method with the set of sticking
    joints revised between iterations.
    """

    def __init__(self, arm: Arm, h: float, q: Array) -> None:
        import pinocchio as pin
        from scipy.linalg.lapack import dgesv

        self._pin, self._solve = pin, dgesv
        self._model = arm.rigid_model()
        self._data = self._model.createData()
        self._wrench = arm.tool_wrench
        self._armature = arm.armature
        self._drive = Drive(arm)
        self._h = h
        self.q = np.array(q, dtype=float)
        self.dq = np.zeros(arm.n)
        self._a = np.zeros(arm.n)
        self._hysteresis = np.zeros(arm.n)
        self._last_q = self.q
        self._lead = self._velocity_lead(arm)

    def step(self, t: float, command: DriveCommand, temperature: Array) -> StepResult:
        """Integrate one step, which starts at t (s), under the torque of the drives."""
        h, drive = self._h, self._drive
        q = self.q + 0.5 * h * self.dq
        if drive.hysteretic.any():
            self._hysteresis = drive.next_hysteresis(self._hysteresis, q - self._last_q)
            self._last_q = q
        state = JointState(np.asarray(t), q, self.dq, np.sign(self.dq), self.dq, temperature)
        a, sign, rigid, smooth, level = self._accelerate(state, command)
        torque = command.torque(a)
        stuck = (sign == 0.0) & ~drive.hysteretic
        v = state.dq
        needed = torque - rigid - smooth - self._armature * a
        dry = np.where(stuck, needed, np.where(drive.hysteretic, self._hysteresis, sign) * level)
        self._a = a
        self.dq = self.dq + h * a
        self.dq[stuck] = 0.0
        self.q = q + 0.5 * h * self.dq
        turning = sign * v < 0.0  # reverses within the step
        return StepResult(q, v, a, torque, rigid, smooth, dry, stuck | turning)

    def _velocity_lead(self, arm: Arm) -> Array:
        """Time (n,) within a step at which its velocity is evaluated: h/2.

        Where damping stops a joint within a step, the midpoint rule oscillates from step to step;
        the velocity at the end of the step, h, does not.
        """
        inertia = self._pin.crba(self._model, self._data, self.q) + np.diag(self._armature)
        overdamped = self._h * arm.friction.viscous * np.diag(np.linalg.inv(inertia)) > 1.0
        return np.where(overdamped, self._h, 0.5 * self._h)

    def _accelerate(
        self, state: JointState, command: DriveCommand
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Solve for the acceleration; sets ``state`` to the mean velocity of the step."""
        h, drive, dq = self._h, self._drive, self.dq
        inertia = self._pin.crba(self._model, self._data, state.q)
        constant = np.zeros(dq.size)
        if self._wrench.any():
            constant = wrench_torque(self._model, self._data, state.q, self._wrench)
        free = drive.hysteretic
        sign = np.where(free, 0.0, np.sign(dq))
        changes = np.zeros(dq.size, dtype=int)
        a = np.where((dq == 0.0) & ~free, 0.0, self._a)
        for _ in range(MAX_ITERATIONS):
            state.dq = dq + self._lead * a
            rigid = (
                inertia @ a + self._pin.nle(self._model, self._data, state.q, state.dq) + constant
            )
            state.load = rigid
            level, smooth = drive.level(state), drive.smooth(state)
            stuck = (sign == 0.0) & ~free
            direction = np.where(free, self._hysteresis, sign)
            torque = command.torque(a)
            balance = rigid + smooth + self._armature * a - torque
            residual = np.where(stuck, a + dq / h, balance + direction * level)
            if np.abs(residual).max() < TOLERANCE * (1.0 + np.abs(torque).max()):
                revised = _revised_signs(sign, stuck, free, dq + h * a, -balance, level, changes)
                if revised is None:
                    return a, sign, rigid, smooth, level
                sign = revised
                state.sign = np.where(free, state.sign, sign)
                continue
            gain = np.where(np.abs(torque) < command.limit, command.gain, 0.0)
            a = a - self._newton_step(state, inertia, gain, direction, stuck, residual)
        return a, sign, rigid, smooth, level

    def _newton_step(
        self,
        state: JointState,
        inertia: Array,
        gain: Array,
        direction: Array,
        stuck: Mask,
        residual: Array,
    ) -> Array:
        drive = self._drive
        slope = drive.level_slope(state)
        matrix = inertia.copy() if slope is None else (1.0 + direction * slope)[:, None] * inertia
        matrix.flat[:: matrix.shape[0] + 1] += (
            self._armature + gain + self._lead * drive.damping(state)
        )
        if stuck.any():
            matrix[stuck] = np.eye(stuck.size)[stuck]
        step: Array = self._solve(matrix, residual)[2]
        return step


def _revised_signs(
    sign: Array,
    stuck: Mask,
    free: Mask,
    after: Array,
    needed: Array,
    level: Array,
    changes: Indices,
) -> Array | None:
    """Return signs in which joints that must stick or slip are changed; None if none must."""
    turned = ~stuck & ~free & (after * sign < 0.0)
    slipping = stuck & (np.abs(needed) > level)
    wrong = (turned | slipping) & (changes < MAX_CHANGES)
    if not wrong.any():
        return None
    changes[wrong] += 1
    return np.where(wrong, np.where(turned, 0.0, np.sign(needed)), sign)
