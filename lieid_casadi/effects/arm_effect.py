"""Effects on the whole arm or on the measurement: their columns need the model along a motion.

Each column is the change of torque that a coefficient causes, divided by the coefficient: value ·
column is the exact change when the fit has converged, and the column is the derivative at zero.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Mask
from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.lie import Motion, constant, tool_pose
from lieid_casadi.dynamics.regressor import regressor
from lieid_casadi.effects.effect import Columns, Effect, ShapeSymbols, Signals
from lieid_casadi.robot import Drive, Robot

Array = NDArray[np.float64]


class SegmentModel(Protocol):
    """A model evaluated along a segment of K samples."""

    @property
    def t(self) -> Array:
        """Time (K,), s."""

    @property
    def motion(self) -> tuple[Array, Array, Array]:
        """q, dq, ddq (K, n)."""

    @property
    def friction_known(self) -> Mask:
        """Whether the friction of each joint is determined (K, n).

        At rest it is not, but a prediction takes it for zero there.
        """

    @property
    def load(self) -> Array:
        """Rigid torque (K, n), N·m."""

    @property
    def torque(self) -> Array:
        """Torque (K, n) of the rigid arm and all effects on single joints, N·m."""

    @property
    def recording(self) -> int | None:
        """Number of the recording of this segment among those to which the model is fitted."""

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the rigid torque (K, n) of another motion (K, n), N·m."""

    @property
    def smooth_load(self) -> Array:
        """Rigid torque (K, n), low-pass filtered such that it can be differentiated twice."""

    def gravity_by_axis(self) -> Array:
        """Return the gravity torques (K, n, 3) of 1 m/s² along each axis of the base."""

    @property
    def command(self) -> Array | None:
        """Commanded position (K, n), rad, None without commands."""

    def held_command(self, joint: int, delay: float, hold: float, *, parts: int = 1) -> Array:
        """Return the commands (parts, K) of a joint that arrive late and are held for a time, s.

        They are the means over parts of that time, whose middle is late by ``delay``, s.
        """

    @property
    def hold(self) -> float:
        """Interval between rows of the recording, for which a command is held, s."""

    @property
    def drives(self) -> Sequence[Drive] | None:
        """Control laws of the joints (n), None without."""

    @property
    def gravity(self) -> Array:
        """Gravity (3,) in the base frame, m/s²."""

    def jacobian(self) -> Array:
        """Return the tool's Jacobian (K, 6, n), [ω; v], base axes."""

    def tool_regressor(self) -> Array:
        """Return the rigid torque (K, n, 10) per link parameter of a body in the tool's frame."""

    def joint_torque_at(self, load: Array) -> Array:
        """Return the torque (K, n) of effects on single joints at another load (K, n), N·m."""


@dataclass(frozen=True, eq=False)
class InstantModel:
    """A model at one instant as symbolic expressions, for generated code.

    ``links`` (10 n,): link parameters; ``load``, ``torque`` (n,): rigid torque, and rigid torque
    with all effects on single joints, N·m.
    """

    robot: Robot
    motion: Motion
    links: ca.SX
    load: ca.SX
    torque: ca.SX

    @property
    def gravity(self) -> ca.SX:
        """Gravity (3,) in the base frame, m/s²."""
        return ca.densify(constant(self.robot.gravity))

    def rigid_beside(self, offset: ca.SX) -> ca.SX:
        """Return the rigid torque (n,) at q + offset (n,), by the addition theorem."""
        m, sin, cos = self.motion, ca.sin(offset), ca.cos(offset)
        moved = Motion(
            m.q + offset, m.sin * cos + m.cos * sin, m.cos * cos - m.sin * sin, m.dq, m.ddq
        )
        return recursion.inverse_dynamics(self.robot, moved, self.links)

    def gravity_torque(self, gravity: ca.SX) -> ca.SX:
        """Return the torque (n,) at rest in another gravity (3,), m/s²."""
        return closed_form.gravity(self.robot, self.motion, self.links, gravity=gravity)

    def jacobian(self) -> ca.SX:
        """Return the tool's Jacobian (6, n), [ω; v], base axes."""
        return closed_form.jacobian(self.robot, self.motion)

    def tool_regressor(self) -> ca.SX:
        """Return the rigid torque (n, 10) per link parameter of a body in the tool frame."""
        body = ca.SX.sym("body", 10)
        at_link = closed_form.seen_from_parent(tool_pose(self.robot), body)
        last = regressor(self.robot, self.motion)[:, -10:]
        return ca.mtimes(last, ca.jacobian(at_link, body))


class ArmEffect(Effect):
    """An effect whose columns are computed along a whole segment.

    Attributes
    ----------
    reach : str
        ``"joint"`` if the columns are zero on all joints but the effect's own, else ``"arm"``.
    on_measurement : bool
        Whether the effect changes what the sensors read, not the torque of the drives.
    trial_values : tuple
        Coefficients other than zero at which a diagnosis tries the columns, because the column
        at a likely value differs from the derivative at zero.
    linear : bool
        Whether the columns are the same at all coefficients.
    needs_past : bool
        Whether the torque at an instant depends on the motion before it, so that no function of
        one instant reproduces the effect.
    export_note : str
        What generated code does instead if it does not reproduce the effect. The columns at an
        instant are then zero by default.
    """

    reach: Literal["arm", "joint"] = "arm"
    on_measurement: ClassVar[bool] = True
    trial_values: ClassVar[tuple[tuple[float, ...], ...]] = ()
    linear: ClassVar[bool] = False
    needs_past: ClassVar[bool] = False
    export_note: ClassVar[str] = ""
    signals: tuple[str, ...] = ()

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        """Return zeros: the columns do not follow from the signals of one joint and instant."""
        return [ca.SX(0) for _ in self.coefficients]

    @abstractmethod
    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        """Return the columns (K, n, c) along a segment, of an effect on a joint (from 0).

        ``values`` (c + s,): current coefficients, about which the columns are taken, then shapes.
        """

    def instant_columns(self, arm: InstantModel, joint: int, values: ca.SX) -> ca.SX | None:
        """Return the columns (n, c) at one instant, None if they depend on more than one.

        The columns times the coefficients are the whole change that these make.
        """
        return ca.SX(arm.load.shape[0], len(self.coefficients)) if self.export_note else None

    def tool_body(self, values: ca.SX) -> ca.SX | None:
        """Return the link parameters (10,) that the coefficients (c,) add in the tool frame."""
        return None


def on_joint(column: Array, joint: int, n: int) -> Array:
    """Return a column (K,) of one joint (from 0) of n as (K, n, 1), zero elsewhere."""
    columns = np.zeros((len(column), n, 1))
    columns[:, joint, 0] = column
    return columns


def lag_torque(arm: SegmentModel, joint: int, lag: Array, size: float = 1.0) -> Array:
    """Return the change (K, n) of the rigid torque if a link lags by size · lag (K,), rad."""
    moved, rate = [x.copy() for x in arm.motion], np.gradient(lag, arm.t)
    for signal, change in zip(moved, (lag, rate, np.gradient(rate, arm.t)), strict=True):
        signal[:, joint] -= size * change
    return arm.rigid(*moved) - arm.load
