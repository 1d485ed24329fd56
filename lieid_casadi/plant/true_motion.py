"""True signals of the plant, before the sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ReferenceTrajectory(Protocol):
    """A reference for the controller; at rest before 0 and after ``duration`` (s)."""

    @property
    def duration(self) -> float:
        """Time from start to end, s."""
        ...

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """q, dq, ddq (N, n) at times (N,)."""
        ...


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """True signals at N instants: t (N,), all others (N, n). SI units.

    τ = rigid + smooth + dry + armature·motor_ddq holds sample by sample.

    Attributes
    ----------
    q, dq, ddq
        Of the links.
    motor_q, motor_dq, motor_ddq
        Of the motors; they differ from those of the links at elastic joints.
    tau
        Torque that the drives deliver.
    rigid
        Torque of the rigid arm, payload and tool wrench included.
    dry
        Dry friction.
    smooth
        All other torques: viscous friction, offset, spring, ripple.
    resting : bool
        Whether the joint was at rest, came to rest or reversed within the step; dry friction then
        does not follow from the velocity.
    temperature
        °C.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    motor_q: Array
    motor_dq: Array
    motor_ddq: Array
    tau: Array
    rigid: Array
    dry: Array
    smooth: Array
    resting: NDArray[np.bool_]
    temperature: Array
