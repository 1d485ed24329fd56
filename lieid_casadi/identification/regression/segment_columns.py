"""Effect columns along a segment, including effects that need the model on all of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.effects.arm_effect import ArmEffect
from lieid_casadi.model import Model
from lieid_casadi.recording.filtering import lowpass
from lieid_casadi.recording.processed import Processed
from lieid_casadi.robot import Drive
from lieid_casadi.robot.inertia import parameter_transport

SMOOTH = 1.0 / 3.0  # of the cut-off, which is at least six times the bandwidth of the motion


@dataclass(frozen=True, eq=False)
class ModelAlongSegment:
    """A model with numerical parameters along a segment; `lieid_casadi.effects.ArmAlong`."""

    compiled: Compiled
    segment: Processed
    parameters: Array  # (10 n + m,): link parameters and effect coefficients
    #: (K, n, m): columns of effects on single joints; those of effects on the whole arm are zero
    joint_columns: Array
    fitted: bool  # whether the model was fitted to this segment
    shapes: Array  # (s,): shape parameters of the effects
    unknown_at_rest: bool = False  # whether friction at rest counts as unknown, otherwise as zero

    @property
    def t(self) -> Array:
        """Time (K,), s."""
        return self.segment.t

    @property
    def motion(self) -> tuple[Array, Array, Array]:
        """q, dq, ddq (K, n)."""
        return self.segment.q, self.segment.dq, self.segment.ddq

    @property
    def friction_known(self) -> NDArray[np.bool_]:
        """Whether the friction of each joint is determined (K, n)."""
        moving = self.segment.moving
        return moving if self.unknown_at_rest else np.ones_like(moving)

    @property
    def _links(self) -> Array:
        return self.parameters[: 10 * self.compiled.n]

    @property
    def coefficients(self) -> Array:
        """Effect coefficients (m,)."""
        return self.parameters[10 * self.compiled.n :]

    @cached_property
    def load(self) -> Array:
        """Rigid torque (K, n), N·m."""
        return self.rigid(*self.motion)

    @cached_property
    def torque(self) -> Array:
        """Torque (K, n) of the rigid arm and all effects on single joints, N·m."""
        return np.asarray(self.load + self.joint_columns @ self.coefficients)

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the rigid torque (K, n) of another motion, N·m."""
        return self.compiled.inverse_dynamics(q, dq, ddq, self._links)

    @cached_property
    def smooth_load(self) -> Array:
        """Rigid torque (K, n) low-passed at a third of the filter's cut-off, N·m.

        Noise near the cut-off would exceed the motion after two derivatives.
        """
        return lowpass(self.load, self.segment.rate, SMOOTH * self.segment.cutoff)

    @property
    def command(self) -> Array | None:
        """Commanded position (K, n), rad, None without commands."""
        return self.segment.command

    @property
    def hold(self) -> float:
        """Interval between rows of the recording, for which a command is held, s."""
        return 1.0 / self.segment.recording.rate

    @property
    def drives(self) -> tuple[Drive, ...] | None:
        """Control laws of the joints (n), None without."""
        return self.compiled.model.robot.drives

    @property
    def gravity(self) -> Array:
        """Gravity (3,) in the base frame, m/s²."""
        return np.asarray(self.compiled.model.robot.gravity)

    def gravity_by_axis(self) -> Array:
        """Return the gravity torques (K, n, 3) of 1 m/s² along each axis of the base."""
        return np.stack(
            [arm.gravity(self.segment.q, self._links) for arm in _in_gravity(self.compiled)],
            axis=-1,
        )

    def jacobian(self) -> Array:
        """Return the tool's Jacobian (K, 6, n), [ω; v], base axes."""
        return self.compiled.jacobian(self.segment.q)

    def joint_torque_at(self, load: Array) -> Array:
        """Return the torque (K, n) of effects on single joints at another load (K, n), N·m."""
        signals: dict[str, Any] = effect_signals(self.segment, self.shapes, load)
        columns = self.compiled.effect_columns(*self.motion, **signals, joint_effects_only=True)
        return np.asarray(columns @ self.coefficients)

    def tool_regressor(self) -> Array:
        """Return the rigid torque (K, n, 10) per link parameter of a body in the tool's frame."""
        last = self.compiled.regressor(*self.motion)[:, :, -10:]
        return np.asarray(last @ parameter_transport(self.compiled.model.robot.tool))


@lru_cache(maxsize=8)
def _in_gravity(compiled: Compiled) -> list[Compiled]:
    """Return the arm without effects in a gravity of 1 m/s² along each axis of the base."""
    robot = compiled.model.robot
    return [compile(Model(replace(robot, gravity=axis))) for axis in np.eye(3)]


def effect_signals(segment: Processed, shapes: Array, load: Array | None) -> dict[str, Array]:
    """Return the signals that effects depend on along a segment, as keywords of `Compiled`."""
    signals = {
        "shapes": shapes,
        "dead_zone": segment.dead_zone,
        "time": segment.t - segment.t[0],
    }
    if load is not None:
        signals["load"] = load
    if segment.temperature is not None:
        signals["temperature"] = segment.temperature
    if segment.command_error is not None:
        signals["command_error"] = segment.command_error
    return signals


def model_along(
    compiled: Compiled,
    segment: Processed,
    shapes: Array,
    parameters: Array,
    *,
    fitted: bool = True,
) -> ModelAlongSegment:
    """Return the model along a segment."""
    load = compiled.inverse_dynamics(
        segment.q, segment.dq, segment.ddq, parameters[: 10 * compiled.n]
    )
    signals: dict[str, Any] = effect_signals(segment, shapes, load)
    columns = compiled.effect_columns(
        segment.q, segment.dq, segment.ddq, **signals, joint_effects_only=True
    )
    return ModelAlongSegment(compiled, segment, parameters, columns, fitted, shapes)


def effects_along(
    compiled: Compiled,
    segment: Processed,
    shapes: Array,
    parameters: Array | None,
    *,
    fitted: bool = True,
) -> Array:
    """Return the columns of all effects (K, n, m) along a segment."""
    if parameters is None:
        signals: dict[str, Any] = effect_signals(segment, shapes, None)
        return compiled.effect_columns(
            segment.q, segment.dq, segment.ddq, **signals, joint_effects_only=True
        )
    every = np.zeros(10 * compiled.n + len(compiled.model.columns))
    every[: len(parameters)] = parameters
    arm = model_along(compiled, segment, shapes, every, fitted=fitted)
    arm_effects = [x for x in compiled.model.slots if isinstance(x.placement.effect, ArmEffect)]
    if not arm_effects:
        return arm.joint_columns
    columns = arm.joint_columns.copy()
    for slot in arm_effects:
        effect, joint = slot.placement.effect, slot.placement.joint
        assert isinstance(effect, ArmEffect)
        values = np.concatenate([arm.coefficients[slot.columns], shapes[slot.shapes]])
        columns[:, :, slot.columns] = effect.segment_columns(arm, joint, values)
    return columns
