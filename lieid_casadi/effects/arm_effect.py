"""Effects on the whole arm or on what is measured: their columns need the model along a motion.

Each is written as the change that a value makes, divided by the value: value · column is then the
exact change once the fit has settled, and the derivative at first.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.effects.effect import Effect, Signals

Array = NDArray[np.float64]


class ArmAlong(Protocol):
    """A model along a segment of K instants, as such effects see it."""

    @property
    def t(self) -> Array:
        """Time (K,), s."""

    @property
    def motion(self) -> tuple[Array, Array, Array]:
        """q, dq, ddq (K, n)."""

    @property
    def load(self) -> Array:
        """Rigid torque (K, n), N·m."""

    @property
    def torque(self) -> Array:
        """Torque (K, n) of the rigid arm and all effects on single joints, N·m."""

    @property
    def fitted(self) -> bool:
        """Whether the segment is one that the model is fitted to."""

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the rigid torque (K, n) of another motion."""

    def smooth(self, x: Array) -> Array:
        """Return a signal (K, …) low-passed so far that it can be derived twice."""

    def gravity_by_axis(self) -> Array:
        """Return the gravity torques (K, n, 3) of 1 m/s² along each axis of the base."""

    @property
    def gravity(self) -> Array:
        """Gravity (3,) in the base frame, m/s²."""

    def jacobian(self) -> Array:
        """Return the tool's Jacobian (K, 6, n), [ω; v], base axes."""

    def tool_regressor(self) -> Array:
        """Return the rigid torque (K, n, 10) per link parameter of a body in the tool's frame."""


class ArmNow(Protocol):
    """A model at one instant, in symbols, as generated code sees it."""

    @property
    def load(self) -> ca.SX:
        """Rigid torque (n,), N·m."""

    @property
    def torque(self) -> ca.SX:
        """Torque (n,) of the rigid arm and all effects on single joints, N·m."""

    def rigid_beside(self, offset: Array) -> ca.SX:
        """Return the rigid torque (n,) at q + offset (n,)."""

    @property
    def gravity(self) -> Array:
        """Gravity (3,) in the base frame, m/s²."""

    def gravity_torque(self, gravity: Array) -> ca.SX:
        """Return the torque (n,) at rest in another gravity (3,)."""

    def jacobian(self) -> ca.SX:
        """Return the tool's Jacobian (6, n), [ω; v], base axes."""

    def tool_regressor(self) -> ca.SX:
        """Return the rigid torque (n, 10) per link parameter of a body in the tool's frame."""


class ArmEffect(Effect):
    """An effect whose columns are computed along a whole segment.

    ``whole_arm`` effects act on no joint in particular. Where one instant is enough, `now` says
    the same in symbols, for generated code.
    """

    whole_arm: ClassVar[bool] = False
    reach: ClassVar[str] = "arm"  # "joint": its columns act on its own joint alone
    #: Coefficients at which the columns are tried before anything is known of them, beside zero:
    #: where the column at a likely value differs from the derivative.
    starts: ClassVar[tuple[tuple[float, ...], ...]] = ()
    #: What generated code does about it where that is not what happens along a recording.
    in_code: ClassVar[str] = ""
    signals: tuple[str, ...] = ()

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return zeros: nothing is known from the signals of one instant."""
        return [ca.SX(0) for _ in self.coefficients]

    @abstractmethod
    def along(self, arm: ArmAlong, joint: int, values: Array) -> Array:
        """Return the columns (K, n, c), given the coefficients (c,) so far."""

    def now(self, arm: ArmNow, joint: int, values: Array) -> ca.SX | None:
        """Return the columns (n, c) at one instant, or None where one does not tell them."""
        return None


def on_joint(column: Array, joint: int, n: int) -> Array:
    """Return a column (K,) of one joint as (K, n, 1)."""
    columns = np.zeros((len(column), n, 1))
    columns[:, joint, 0] = column
    return columns
