"""Time integration of the plant: rigid dynamics, effects, dry friction with stick and slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.plant.arm import Arm
from lieid_casadi.plant.drive import Drive
from lieid_casadi.plant.effects import JointState
from lieid_casadi.plant.ideal_tracking import TrueMotion
from lieid_casadi.plant.rigid import wrench_torque

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
    resting: NDArray[np.bool_]


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
        stuck: NDArray[np.bool_],
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
    stuck: NDArray[np.bool_],
    free: NDArray[np.bool_],
    after: Array,
    needed: Array,
    level: Array,
    changes: NDArray[np.int_],
) -> Array | None:
    """Return signs in which joints that must stick or slip are changed; None if none must."""
    turned = ~stuck & ~free & (after * sign < 0.0)
    slipping = stuck & (np.abs(needed) > level)
    wrong = (turned | slipping) & (changes < MAX_CHANGES)
    if not wrong.any():
        return None
    changes[wrong] += 1
    return np.where(wrong, np.where(turned, 0.0, np.sign(needed)), sign)
