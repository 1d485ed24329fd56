"""Joints that do not move enough for effects on them to be identified."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.events.event import Event
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.messages import joints_text
from lieid_casadi.recording import Processed
from lieid_casadi.robot import Robot

PRISMATIC = 0.1  # m of a prismatic joint that count as 1 rad


def moves_enough(
    robot: Robot, segments: Sequence[Processed], least_motion: float
) -> NDArray[np.bool_]:
    """Return whether each joint (n,) covers enough positions in at least one segment.

    Parameters
    ----------
    robot : Robot
    segments : sequence of Processed
    least_motion : float
        Range of positions, rad; a tenth of it in m for prismatic joints.
    """
    ranges = np.max([np.ptp(segment.q, axis=0) for segment in segments], axis=0)
    unit = np.array([1.0 if joint.revolute else PRISMATIC for joint in robot.joints])
    moving = np.any([segment.moving.any(axis=0) for segment in segments], axis=0)
    return np.asarray(moving & (ranges > unit * least_motion))


def standstill_events(
    robot: Robot, segments: Sequence[Processed], least_motion: float
) -> tuple[Event, ...]:
    """Return one event that names the joints that do not move enough, if there are any.

    Parameters
    ----------
    robot : Robot
    segments : sequence of Processed
    least_motion : float
        See `moves_enough`.
    """
    still = ~moves_enough(robot, segments, least_motion)
    if not still.any():
        return ()
    first, last = segments[0], segments[-1]
    name = first.recording.name or "recording"
    if still.all():
        consequence = "no effect can be identified; record a motion of the joints"
    else:
        consequence = "effects on them cannot be identified and are not searched for"
    verb = "moves" if still.sum() == 1 else "move"
    sentence = (
        f"{joints_text(still).capitalize()} {verb} less than {least_motion:g} rad: {consequence}."
    )
    return (
        Event(
            "standstill",
            Source(name, first.recording.source_hash),
            float(first.t[0]),
            float(last.t[-1]),
            tuple(map(int, np.flatnonzero(still))),
            0.0,
            sentence,
        ),
    )
