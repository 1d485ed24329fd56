"""What truly happened on the plant, before any sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ReferenceTrajectory(Protocol):
    """A motion to track: at rest before 0 and after ``duration`` (s)."""

    @property
    def duration(self) -> float:
        """Time from start to end, s."""
        ...

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """q, dq, ddq (N, n) at times (N,)."""
        ...


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """True signals at N instants; (N, n) but for t (N,). SI units.

    τ = rigid + smooth + dry + armature·motor_ddq holds sample by sample.

    Attributes
    ----------
    q, dq, ddq
        Of the links.
    motor_q, motor_dq, motor_ddq
        Of the motors: the same, but for elastic joints.
    tau
        Torque that the drives deliver.
    rigid
        Torque that the rigid arm takes (payload and tool wrench included).
    dry
        Dry friction.
    smooth
        Everything else: viscous friction, offset, spring, ripple …
    resting : bool
        Where the joint was at rest, or came to rest or turned within the step: dry friction is
        then not what the law of motion says at this velocity.
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
