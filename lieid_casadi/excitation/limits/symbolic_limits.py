"""Limits that are expressions of the motion, and the Cartesian speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics.lie import Motion as Symbols
from lieid_casadi.dynamics.lie import (
    Pose,
    axes,
    constant,
    cross,
    inverse_adjoint_times,
    relative_poses,
)
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.excitation.fitted_arm import FittedArm
from lieid_casadi.excitation.limits.constraint_sets import ConstraintSet
from lieid_casadi.excitation.sample_functions import SampleKernel, motion_jacobian
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]
SMOOTHING = 1e-4  # m/s; √(v² + SMOOTHING²) has a gradient at rest


class Limit(Protocol):
    """A limit that a caller specifies; for a robot it becomes a constraint set."""

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """Return the set for a robot; None if no motion of the robot can violate the limit.

        Parameters
        ----------
        robot : Robot
        fit : FittedArm, optional
            Identified parameters, for limits that depend on the torque.

        Raises
        ------
        ExcitationError
            The robot lacks what the limit needs.
        """


def sets_of(
    limits: Sequence[Limit], robot: Robot, fit: FittedArm | None
) -> tuple[tuple[ConstraintSet, ...], tuple[str, ...]]:
    """Return the constraint sets of limits, and the quantities that they leave out.

    Parameters
    ----------
    limits : sequence of Limit
    robot : Robot
    fit : FittedArm or None

    Raises
    ------
    ExcitationError
        One of them is not a limit.
    """
    for limit in limits:
        if not hasattr(limit, "on"):
            raise ExcitationError(f"limits: {limit!r:.60}; expected limits, such as Torque()")
    made = [s for s in (limit.on(robot, fit) for limit in limits) if s is not None]
    left_out = dict.fromkeys(label for s in made for label in s.left_out)
    return tuple(s for s in made if s.labels), tuple(left_out)


class SymbolicSet(ConstraintSet):
    """Quantities given as CasADi expressions, with exact Jacobians.

    Parameters
    ----------
    name : str
        Of the functions; letters, digits and underscores.
    symbols : Symbols
        Of the motion.
    quantities : SX (k,)
    jacobian : SX (k, 3 n), optional
        ∂quantities/∂(q, dq, ddq). Default: by differentiation.
    labels, units, lower, upper, scale, remedy, left_out
        See `ConstraintSet`.
    """

    def __init__(
        self,
        name: str,
        symbols: Symbols,
        quantities: ca.SX,
        jacobian: ca.SX | None = None,
        *,
        labels: Sequence[str],
        units: Sequence[str],
        lower: Array,
        upper: Array,
        scale: Array,
        remedy: str,
        left_out: Sequence[str] = (),
    ) -> None:
        slopes = motion_jacobian(quantities, symbols) if jacobian is None else jacobian
        self._values = SampleKernel(name, symbols, ca.densify(quantities))
        self._slopes = SampleKernel(f"{name}_jacobian", symbols, slopes)
        self.labels, self.units = tuple(labels), tuple(units)
        self.lower, self.upper, self.scale = lower, upper, scale
        self.remedy, self.left_out = remedy, tuple(left_out)

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return self._values.dense(motion)[:, 0]  # identically zero quantities included

    def jacobian(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return self._slopes.dense(motion)


@dataclass(frozen=True)
class CartesianSpeed:
    """Speed of the tool and of every joint's centre within a limit.

    Parameters
    ----------
    limit : float
        m/s, above 0.
    """

    limit: float

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        _positive("Cartesian speed", self.limit)
        symbols = Symbols.symbols(robot.n)
        twists = link_twists(robot, symbols)
        points = [(f"centre of joint {i + 1}", v, np.zeros(3)) for i, v in enumerate(twists)]
        points.append(("tool", twists[-1], robot.tool[:3, 3]))
        labels, speeds = [], []
        for label, twist, point in points:
            squared = ca.sumsqr(twist[3:] + cross(twist[:3], constant(point)))
            if ca.depends_on(squared, symbols.dq):
                labels.append(f"speed of the {label}")
                speeds.append(ca.sqrt(squared + SMOOTHING**2))
        return SymbolicSet(
            "speed", symbols, ca.vertcat(*speeds), labels=labels, units=["m/s"] * len(labels),
            lower=np.full(len(labels), -np.inf), upper=np.full(len(labels), self.limit),
            scale=np.full(len(labels), self.limit),
            remedy="a longer duration or a higher Cartesian speed",
        )  # fmt: skip


def link_twists(robot: Robot, symbols: Symbols) -> list[ca.SX]:
    """Return the twist [ω; v] (6,) of every link, in its own frame (Eq. 2)."""
    twist, twists = ca.SX(6, 1), []
    for i, (g, xi) in enumerate(zip(relative_poses(robot, symbols), axes(robot), strict=True)):
        twist = inverse_adjoint_times(g, twist) + xi * symbols.dq[i]
        twists.append(twist)
    return twists


def link_poses(robot: Robot, symbols: Symbols) -> list[Pose]:
    """Return the frames of the base and of every link, in the base frame."""
    poses = [Pose(ca.SX(ca.DM.eye(3)), ca.SX(3, 1))]
    for g in relative_poses(robot, symbols):
        poses.append(poses[-1] @ g)
    return poses


def _positive(name: str, value: float) -> None:
    if not value > 0.0:
        raise ExcitationError(f"{name}: {value:g}; expected a positive number")
