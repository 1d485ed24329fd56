"""Joint limits of a robot, with defaults, checked for a design."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.limits.constraint_sets import JointLimits
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]
ACCELERATION = 3.0  # rad/s² (m/s²) where the robot states none
LEAST_MOTION = 0.05  # rad; shorter durations are refused


@dataclass(frozen=True, eq=False)
class MotionRange:
    """Limits of every joint: position (n, 2), velocity and acceleration (n,).

    rad, rad/s, rad/s² (m for prismatic joints). Positions are infinite without end stops.
    """

    position: Array
    velocity: Array
    acceleration: Array
    revolute: NDArray[np.bool_]

    @property
    def _stops(self) -> NDArray[np.bool_]:
        """Whether each joint has end stops (n, 1)."""
        return np.asarray(np.isfinite(self.position).all(axis=1, keepdims=True))

    @property
    def middle(self) -> Array:
        """Middle of the joint ranges (n,), zero without end stops."""
        return np.asarray(np.where(self._stops, self.position, 0.0).mean(axis=1))

    @property
    def units(self) -> Array:
        """Half range, velocity and acceleration limit (n, 3), as units of the free variables."""
        half = np.where(self._stops, self.position, [-np.pi, np.pi])
        return np.stack([0.5 * np.ptp(half, axis=1), self.velocity, self.acceleration], axis=1)

    def constraint_set(self) -> JointLimits:
        """Return the limits as a constraint set."""
        return JointLimits(self.position, self.velocity, self.acceleration, revolute=self.revolute)


def motion_range(
    robot: Robot, acceleration: ArrayLike | None = None, *, margin: float = 1.0
) -> MotionRange:
    """Return the limits of a robot.

    Parameters
    ----------
    robot : Robot
    acceleration : float or (n,), optional
        In place of the robot's own, rad/s². Default: 3 rad/s² (m/s²) where it states none.
    margin : float
        Part of the velocity limits that is used.

    Raises
    ------
    ExcitationError
        No velocity limit, an empty position range, or an acceleration that is not positive.
    """
    position = np.stack([robot.limit("position_lower"), robot.limit("position_upper")], axis=1)
    position = np.where(np.isnan(position), [-np.inf, np.inf], position)
    for j, (low, high) in enumerate(position):
        if not low < high:
            raise ExcitationError(
                f"robot {robot.name!r}: position limits of {_joint(robot, j)} contradict each "
                f"other: lower {low:g}, upper {high:g}"
            )
    if not 0.0 < margin <= 1.0:
        raise ExcitationError(f"margin: {margin:g}; expected more than 0, at most 1")
    velocity = margin * robot.limit("velocity")
    missing = [_joint(robot, j) for j in range(robot.n) if not velocity[j] > 0.0]
    if missing:
        raise ExcitationError(
            f"robot {robot.name!r} states no velocity limit for {', '.join(missing)}; "
            "add it to the robot's description"
        )
    revolute = np.array([joint.revolute for joint in robot.joints])
    return MotionRange(position, velocity, _acceleration(robot, acceleration), revolute)


def check_start_pose(robot: Robot, limits: MotionRange, pose: Array) -> None:
    """Refuse a start pose outside the position limits.

    Parameters
    ----------
    robot : Robot
    limits : MotionRange
    pose : (n,)
        rad.

    Raises
    ------
    ExcitationError
    """
    if pose.shape != (robot.n,) or not np.all(np.isfinite(pose)):
        raise ExcitationError(f"start pose: {pose.size} numbers; expected {robot.n}, one per joint")
    for j, (low, high) in enumerate(limits.position):
        if not low < pose[j] < high:
            raise ExcitationError(
                f"start pose: {_joint(robot, j)} at {pose[j]:g}, outside its position limits "
                f"{low:g} … {high:g}"
            )


def check_duration(robot: Robot, limits: MotionRange, duration: float) -> None:
    """Refuse a duration in which the limits allow less than 0.05 rad of motion.

    Parameters
    ----------
    robot : Robot
    limits : MotionRange
    duration : float
        Of one period, s.

    Raises
    ------
    ExcitationError
        Names the limit and a sufficient duration.
    """
    rate = 2.0 * np.pi / duration
    for name, limit, power in (
        ("velocity", limits.velocity, 1),
        ("acceleration", limits.acceleration, 2),
    ):
        reach = limit / rate**power
        j = int(np.argmin(reach))
        if reach[j] < LEAST_MOTION:
            enough = 2.0 * np.pi * (LEAST_MOTION / limit[j]) ** (1.0 / power)
            raise ExcitationError(
                f"duration: {duration:g} s is too short for the {name} limit of "
                f"{_joint(robot, j)}, {limit[j]:g}: its amplitude would be {reach[j]:.2g} rad; "
                f"expected {enough:.2g} s at least"
            )


def _acceleration(robot: Robot, given: ArrayLike | None) -> Array:
    if given is None:
        stated = robot.limit("acceleration")
        return np.where(np.isfinite(stated), stated, ACCELERATION)
    values = np.atleast_1d(np.asarray(given, dtype=float))
    if values.size not in (1, robot.n):
        raise ExcitationError(
            f"acceleration: {values.size} numbers; expected 1 or {robot.n}, one per joint"
        )
    if not np.all(np.isfinite(values) & (values > 0.0)):
        raise ExcitationError("acceleration: expected positive numbers")
    return np.broadcast_to(values, robot.n).copy()


def _joint(robot: Robot, j: int) -> str:
    return f"joint {j + 1} ({robot.joints[j].name})"
