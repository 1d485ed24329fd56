"""What the plant's hidden effects have in common.

Written on their own: nothing here comes from ``lieid_casadi.effects``, so that one mistake
cannot hide in both. Each effect carries the name of DESIGN's table, for scoring.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(slots=True)
class JointState:
    """What a joint's torque may depend on: (n,) in a simulation, (N, n) along a path.

    Attributes
    ----------
    t
        () or (N,), s.
    q, dq
        Angle and velocity of the motor (of the link, where the joint is rigid).
    sign
        Direction of motion: −1, 0 at rest, 1.
    load
        Rigid torque, payload included; armature and friction not. N·m.
    temperature
        °C.
    """

    t: Array
    q: Array
    dq: Array
    sign: Array
    load: Array
    temperature: Array


@dataclass(frozen=True)
class HiddenEffect:
    """An effect of the plant."""

    name: ClassVar[str] = ""


@dataclass(frozen=True)
class JointEffect(HiddenEffect):
    """An effect on the torque of one joint (from 0); what it leaves out, it does not change.

    The drive's torque is rigid + armature·q̈ + ``torque``
    + ``viscous_scale``·(f_v·q̇ + ``viscous``) + dry friction, where dry friction is
    sgn(q̇)·``level_scale``·(f_c + ``level``) in motion and whatever is needed, up to that level,
    at rest.
    """

    joint: int

    def level(self, s: JointState) -> Array:
        """Return what is added to the level of dry friction, N·m."""
        return np.zeros(())

    def level_slope(self, s: JointState) -> Array:
        """Return the derivative of ``level`` by the load, for the simulation's Newton steps."""
        return np.zeros(())

    def level_scale(self, s: JointState) -> Array:
        """Return the factor on dry friction."""
        return np.ones(())

    def viscous(self, s: JointState) -> Array:
        """Return added friction that vanishes at rest, N·m."""
        return np.zeros(())

    def viscous_scale(self, s: JointState) -> Array:
        """Return the factor on friction that vanishes at rest."""
        return np.ones(())

    def torque(self, s: JointState) -> Array:
        """Return added torque that is not friction of this joint, N·m."""
        return np.zeros(())
