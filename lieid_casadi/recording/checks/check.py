"""All checks of a recording: errors for what is certainly wrong, warnings for the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.errors import LieidWarning, RecordingError
from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.checks.block_means import block_means
from lieid_casadi.recording.checks.motion import (
    check_rate,
    check_still,
    check_time,
    check_velocity,
)
from lieid_casadi.recording.checks.torque import check_torque
from lieid_casadi.recording.checks.units import check_units
from lieid_casadi.recording.faults import require_sound
from lieid_casadi.recording.recording import Recording
from lieid_casadi.recording.sample_timing import require_plausible_rate

if TYPE_CHECKING:
    from lieid_casadi.robot.robot import Robot


def check(
    recording: Recording,
    robot: Robot | None = None,
    *,
    nominal_torque: ArrayLike | None = None,
) -> tuple[LieidWarning, ...]:
    """Check a recording, against a robot where one is given.

    Parameters
    ----------
    recording
        Signals of one run.
    robot
        Adds the number of joints and the limits.
    nominal_torque
        (N, n) torque of the robot's nominal model at the recording's rows: adds sign and
        order of the torques. Without it, signs are checked against friction only.

    Returns
    -------
    tuple of LieidWarning
        The recording's own warnings first, then dropouts and irregular stamps, units and
        limits, velocity against position, joints at rest, rate, torque.

    Raises
    ------
    RecordingError
        What is certainly wrong: NaN or Inf, time that does not increase or is not in seconds,
        another number of joints, degrees.
    """
    require_sound(recording)
    require_plausible_rate(recording.t, recording.title)
    _require_joints(recording, robot)
    nominal = _nominal(recording, nominal_torque)
    blocks = block_means(recording, nominal)
    return (
        *recording.warnings,
        *check_time(recording),
        *check_units(recording, robot),
        *check_velocity(recording, blocks),
        *check_still(recording, robot),
        *check_rate(recording),
        *check_torque(recording, blocks, robot),
    )


def _require_joints(recording: Recording, robot: Robot | None) -> None:
    if robot is not None and robot.n != recording.n:
        raise RecordingError(
            f"{recording.title}: found {recording.n} joints "
            f"(q1…q{recording.n}), expected {robot.n} as the robot {robot.name} has"
        )


def _nominal(recording: Recording, nominal_torque: ArrayLike | None) -> Array | None:
    if nominal_torque is None:
        return None
    nominal = np.asarray(nominal_torque, dtype=np.float64)
    if nominal.shape != recording.q.shape:
        raise RecordingError(
            f"nominal_torque has shape {nominal.shape}, expected {recording.q.shape}"
        )
    return nominal
