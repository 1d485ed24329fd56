"""Effect columns along a segment, including effects that need the model on all of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.effects import Placement
from lieid_casadi.effects.arm_effect import ArmEffect
from lieid_casadi.effects.command_delay import CommandDelay, held_for
from lieid_casadi.effects.torque_saturation import TorqueSaturation
from lieid_casadi.expressions.effect_function import EffectFunction, sign_of
from lieid_casadi.model import Model
from lieid_casadi.recording.filtering import lowpass
from lieid_casadi.recording.processed import Processed
from lieid_casadi.robot import Drive
from lieid_casadi.robot.inertia import parameter_transport

AT_ONCE = 1 << 17  # values of a column: temporary arrays stay in the cache
SMOOTH = 1.0 / 3.0  # of the cut-off, which is at least six times the bandwidth of the motion


@dataclass(frozen=True, eq=False)
class ModelAlongSegment:
    """A model with numerical parameters along a segment; `lieid_casadi.effects.ArmAlong`."""

    compiled: Compiled
    segment: Processed
    parameters: Array  # (10 n + m,): link parameters and effect coefficients
    recording: int | None  # its number among those to which the model is fitted
    shapes: Array  # (s,): shape parameters of the effects

    @property
    def t(self) -> Array:
        """Time (K,), s."""
        return self.segment.t

    @property
    def motion(self) -> tuple[Array, Array, Array]:
        """q, dq, ddq (K, n)."""
        return self.segment.q, self.segment.dq, self.segment.ddq

    @property
    def friction_known(self) -> Mask:
        """Whether the friction of each joint is determined (K, n)."""
        moving = self.segment.moving
        return moving if self.recording is not None else np.ones_like(moving)

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
        return self.load + self.joint_torque_at(self.load)

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

    def held_command(self, joint: int, delay: float, hold: float, *, parts: int = 1) -> Array:
        """Return the commands (parts, K) of a joint that arrive late and are held for a time, s."""
        return self.segment.held_command(joint, delay, hold, parts=parts)

    @property
    def hold(self) -> float:
        """Interval between rows of the recording, for which a command is held, s."""
        return 1.0 / self.segment.recording.rate

    @cached_property
    def drives(self) -> tuple[Drive, ...] | None:
        """Control laws of the joints (n) within the limits of the model, None without."""
        model = self.compiled.model
        if model.robot.drives is None:
            return None
        laws = list(model.robot.drives)
        for slot in model.slots:
            if isinstance(slot.placement.effect, TorqueSaturation):
                j = slot.placement.joint
                laws[j] = laws[j].saturated(float(self.shapes[slot.shapes.start]))
        return tuple(laws)

    @property
    def late_error(self) -> Array | None:
        """Errors (K, n) of position control with the delays of the model, None without commands."""
        command, found = self.segment.command, self.segment.command_error
        if command is None or found is None:
            return found
        late = command.copy()
        for column, value in zip(self.compiled.model.columns, self.coefficients, strict=True):
            if column.name == f"{CommandDelay.name}.delta" and value > 0.0:
                j, delay = column.joint, float(value)
                late[:, j] = self.held_command(j, delay, held_for(delay, self.hold))[0]
        return replace(self.segment, command=late).command_error

    @property
    def gravity(self) -> Array:
        """Gravity (3,) in the base frame, m/s²."""
        return np.asarray(self.compiled.model.robot.gravity)

    def gravity_by_axis(self) -> Array:
        """Return the gravity torques (K, n, 3) of 1 m/s² along each axis of the base."""
        return self._gravity_by_axis

    @cached_property
    def _gravity_by_axis(self) -> Array:
        arms = _in_gravity(self.compiled)
        return np.stack([arm.gravity(self.segment.q, self._links) for arm in arms], axis=-1)

    def jacobian(self) -> Array:
        """Return the tool's Jacobian (K, 6, n), [ω; v], base axes."""
        return self._jacobian

    @cached_property
    def _jacobian(self) -> Array:
        return self.compiled.jacobian(self.segment.q)

    def arm_columns(self) -> dict[int, Array]:
        """Return the columns (K, n) of effects on the whole arm, by their positions."""
        found: dict[int, Array] = {}
        for slot in self.compiled.model.slots:
            if not isinstance(effect := slot.placement.effect, ArmEffect):
                continue
            values = np.concatenate([self.coefficients[slot.columns], self.shapes[slot.shapes]])
            columns = effect.segment_columns(self, slot.placement.joint, values)
            found |= {slot.columns.start + i: columns[..., i] for i in range(columns.shape[2])}
        return found

    def joint_torque_at(self, load: Array) -> Array:
        """Return the torque (K, n) of effects on single joints at another load (K, n), N·m."""
        signals: dict[str, Any] = effect_signals(self.segment, self.shapes, load)
        given = (*self.motion, self.coefficients)
        return self.compiled.effect_torque(*given, **signals, joint_effects_only=True)

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
    signals = {"shapes": shapes, "dead_zone": segment.dead_zone, "time": segment.t - segment.t[0]}
    if load is not None:
        signals["load"] = load
    if segment.temperature is not None:
        signals["temperature"] = segment.temperature
    if segment.command_error is not None:
        signals["command_error"] = segment.command_error
    return signals


def model_along(
    compiled: Compiled, segment: Processed, shapes: Array, parameters: Array, *, fitted: bool = True
) -> ModelAlongSegment:
    """Return the model along a segment."""
    every = np.zeros(10 * compiled.n + len(compiled.model.columns))
    every[: len(parameters)] = parameters
    number = segment.number if fitted else None
    return ModelAlongSegment(compiled, segment, every, number, shapes)


def effects_along(
    compiled: Compiled, segment: Processed, shapes: Array, parameters: Array, *, fitted: bool = True
) -> Array:
    """Return the columns of all effects (K, n, m) along a segment."""
    arm = model_along(compiled, segment, shapes, parameters, fitted=fitted)
    own = arm.arm_columns()
    count = len(compiled.model.columns)
    if len(own) == count:  # other columns, which are large, are not needed
        columns = np.zeros((len(segment), compiled.n, count))
    else:
        signals: dict[str, Any] = effect_signals(segment, shapes, arm.load)
        columns = compiled.effect_columns(*arm.motion, **signals, joint_effects_only=True)
    for k, values in own.items():
        columns[:, :, k] = values
    return columns


def signals_along(segment: Processed, load: Array, error: Array | None) -> dict[str, Array]:
    """Return the signals of effects on single joints by name, (K, n) each, for `EffectFunction`.

    ``error`` is that of position control, None without commands.
    """
    shape, temperature = segment.q.shape, segment.temperature
    signals = {
        "q": segment.q,
        "dq": segment.dq,
        "ddq": segment.ddq,
        "sign": sign_of(segment.dq, segment.dead_zone),
        "load": load,
        "temperature": np.zeros(shape) if temperature is None else temperature,
        "time": np.tile((segment.t - segment.t[0])[:, None], shape[1]),
        "command_error": np.zeros(shape) if error is None else error,
    }
    return {name: np.asfortranarray(values) for name, values in signals.items()}


def filtered_columns(
    function: EffectFunction,
    segment: Processed,
    signals: Mapping[str, Array],
    placements: Sequence[Placement],
    grid: Array,
) -> Array:
    """Return the filtered columns (M, P, G, c) of one effect at P places.

    The grid of shape parameters is (G, s), or (P, G, s) with other values at each place.
    """
    places = [(p.joint, p.source) for p in placements]
    size = max(AT_ONCE // (len(segment) * len(places)), 1)
    parts = []
    for first in range(0, grid.shape[-2], size):
        raw = function.columns(signals, places, grid[..., first : first + size, :])
        parts.append(segment.filter(raw.reshape(len(raw), -1)).reshape(-1, *raw.shape[1:]))
    return np.concatenate(parts, axis=2)
