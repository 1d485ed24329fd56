"""Degrees in place of radians: an error where it is certain, a warning where it is not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.errors import JointLimitWarning, LieidWarning, RecordingError, UnitsWarning
from lieid_casadi.recording.arrays import Array, Mask
from lieid_casadi.recording.joint_names import joints_text
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.sample_timing import require_plausible_rate

if TYPE_CHECKING:
    from lieid_casadi.robot.robot import Robot

#: Positions beyond the limits by this factor (and half a radian) are not in radians.
FAR_BEYOND = 2.0
#: Two turns: without stated limits, half of the joints beyond this means degrees.
TWO_TURNS = 4.0 * np.pi
#: Faster than the joints of any arm, rad/s; for warnings only.
FASTEST = 30.0
REMEDY = "convert with --units deg (units='deg' in Python)"


def require_plausible_units(recording: Recording, robot: Robot | None = None) -> None:
    """Refuse stamps that are not in seconds and positions that are not in radians.

    Parameters
    ----------
    recording
        As it was loaded.
    robot
        Adds the position limits.

    Raises
    ------
    RecordingError
        Names the unit that the values seem to be in.
    """
    require_plausible_rate(recording.t, recording.title)
    check_units(recording, robot)


def check_units(recording: Recording, robot: Robot | None) -> list[LieidWarning]:
    """Refuse degrees; warn where values look like degrees or leave the robot's limits.

    Raises
    ------
    RecordingError
        Joints far beyond their limits or, without limits, half of them beyond two turns.
    """
    title = recording.title
    revolute = np.ones(recording.n, dtype=bool)
    if robot is not None:
        revolute = np.array([joint.revolute for joint in robot.joints])
    lower, upper = _position_limits(recording, robot)
    largest = np.max(np.abs(recording.q), axis=0)
    stated = revolute & np.isfinite(lower) & np.isfinite(upper)
    reach = np.maximum(np.abs(lower), np.abs(upper))
    far = stated & (largest > FAR_BEYOND * reach + 0.5)
    if far.any() and (far.sum() >= 2 or stated.sum() <= 2 or np.any(largest > 10.0 * reach)):
        joint = int(np.argmax(np.where(far, largest / reach, 0.0)))
        raise RecordingError(
            f"{title}: column q{joint + 1}: found {largest[joint]:.4g} where the robot's limits "
            f"are {lower[joint]:.4g} to {upper[joint]:.4g} rad, expected radians; if these are "
            f"degrees, {REMEDY}"
        )
    free = revolute & ~stated
    if free.sum() >= 2 and np.median(largest[free]) > TWO_TURNS:
        joint = int(np.argmax(np.where(free, largest, 0.0)))
        raise RecordingError(
            f"{title}: column q{joint + 1}: found {largest[joint]:.4g}, "
            f"{largest[joint] / (2.0 * np.pi):.0f} turns, expected radians; if these are degrees, "
            f"{REMEDY}"
        )
    return [
        *_suspicious(recording, title, free, revolute),
        *_beyond_limits(recording, title, lower, upper),
    ]


def _suspicious(recording: Recording, title: str, free: Mask, revolute: Mask) -> list[LieidWarning]:
    largest = np.max(np.abs(recording.q), axis=0)
    turns = free & (largest > TWO_TURNS)
    if turns.any():
        return [
            UnitsWarning(
                f"{title}: positions of {joints_text(turns)} exceed two turns "
                f"({largest[turns].max():.4g} rad); if these are degrees, {REMEDY}"
            )
        ]
    if recording.dq is None:
        return []
    fast = revolute & (np.max(np.abs(recording.dq), axis=0) > FASTEST)
    if not fast.any():
        return []
    top = float(np.abs(recording.dq[:, fast]).max())
    return [
        UnitsWarning(
            f"{title}: {joints_text(fast)} reach {top:.4g} rad/s; if these are degrees per second, "
            f"{REMEDY}"
        )
    ]


def _beyond_limits(
    recording: Recording, title: str, lower: Array, upper: Array
) -> list[LieidWarning]:
    with np.errstate(invalid="ignore"):
        over = np.maximum(recording.q.max(axis=0) - upper, lower - recording.q.min(axis=0))
        outside = over > 0.02
    if not outside.any():
        return []
    return [
        JointLimitWarning(
            f"{title}: positions of {joints_text(outside)} exceed the robot's limits by up to "
            f"{over[outside].max():.3g}: check the zero pose, the robot and the unit"
        )
    ]


def _position_limits(recording: Recording, robot: Robot | None) -> tuple[Array, Array]:
    if robot is None:
        unknown = np.full(recording.n, np.nan)
        return unknown, unknown
    lower = np.array([joint.limits.position_lower for joint in robot.joints])
    upper = np.array([joint.limits.position_upper for joint in robot.joints])
    return lower, upper
