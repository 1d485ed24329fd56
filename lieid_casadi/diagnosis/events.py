"""Stretches of recordings that say nothing about the arm: they are found and left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.arrays import Mask
from lieid_casadi.diagnosis.transients import Event, transient_events
from lieid_casadi.effects.backlash import Backlash
from lieid_casadi.effects.presliding import Presliding
from lieid_casadi.effects.torque_saturation import TorqueSaturation
from lieid_casadi.errors import IdentificationError, NoSolution, RecordingError
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.identify import Method
from lieid_casadi.identification.recording_checks import Source, check_recordings
from lieid_casadi.messages import joints_text
from lieid_casadi.recording import Processed, Recording, process
from lieid_casadi.recording.conversion import is_torque_of_laws
from lieid_casadi.recording.sample_timing import gap_limit
from lieid_casadi.robot import Robot

OF_DRIVES = (TorqueSaturation.name, Backlash.name)  # effects that act for short times
MARGIN = 0.1  # s on both sides of an event
#: Range of positions (rad, a tenth of it in m) that a joint must cover for effects on it: less is
#: compliance of a held joint.
LEAST_MOTION = 0.05
PRISMATIC = 0.1  # m of a prismatic joint that count as 1 rad


def leave_out_events(
    fit: Fit, recordings: Sequence[Recording]
) -> tuple[list[Recording], tuple[Event, ...]]:
    """Return recordings without contact and faults, and these events and joints at rest.

    Raises what `compare` raises, and `RecordingError` if nothing remains.
    """
    check_recordings(fit.model, recordings)
    events = transient_events(fit, recordings)
    kept = without_events(recordings, events)
    return kept, (*events, *standstill_events(fit.model.robot, process(kept, fit.processing)))


def without_events(recordings: Sequence[Recording], events: Sequence[Event]) -> list[Recording]:
    """Return the recordings without their stretches of contact and faults; standstill is kept.

    The gap that remains divides a recording into segments, which are never joined. Raises
    `RecordingError` if nothing remains.
    """
    kept = [_without(recording, events) for recording in recordings]
    if not any(len(recording) for recording in kept):
        raise RecordingError("the whole recording is contact or faults; nothing can be judged")
    return [recording for recording in kept if len(recording)]


def _without(recording: Recording, events: Sequence[Event]) -> Recording:
    keep = np.ones(len(recording), dtype=bool)
    margin = max(MARGIN, gap_limit(recording.t))
    for event in events:
        if event.kind != "standstill" and event.recording.sha256 == recording.source_hash:
            keep &= (recording.t < event.start - margin) | (recording.t > event.end + margin)
    return recording if keep.all() else recording.at(keep)


def moves_enough(robot: Robot, segments: Sequence[Processed]) -> Mask:
    """Return whether each joint (n,) covers enough positions in at least one segment."""
    ranges = np.max([np.ptp(segment.q, axis=0) for segment in segments], axis=0)
    unit = np.array([1.0 if joint.revolute else PRISMATIC for joint in robot.joints])
    moving = np.any([segment.moving.any(axis=0) for segment in segments], axis=0)
    return np.asarray(moving & (ranges > unit * LEAST_MOTION))


def standstill_events(robot: Robot, segments: Sequence[Processed]) -> tuple[Event, ...]:
    """Return one event that names the joints that do not move enough, if there are any."""
    still = ~moves_enough(robot, segments)
    if not still.any():
        return ()
    first, last = segments[0], segments[-1]
    name = first.recording.name or "recording"
    verb, them = ("moves", "it") if still.sum() == 1 else ("move", "them")
    consequence = f"effects on {them} cannot be identified and are not searched for"
    if still.all():
        consequence = "no effect can be identified; record a motion of the joints"
    sentence = (
        f"{joints_text(still).capitalize()} {verb} less than {LEAST_MOTION:g} rad: {consequence}."
    )
    source, joints = Source(name, first.recording.source_hash), np.flatnonzero(still)
    start, end = float(first.t[0]), float(last.t[-1])
    return (Event("standstill", source, start, end, tuple(map(int, joints)), 0.0, sentence),)


def follows_commands(robot: Robot, recordings: Sequence[Recording]) -> bool:
    """Return whether the torque of the recordings is that of the robot's control laws."""
    drives = robot.drives
    return drives is not None and all(is_torque_of_laws(r, drives) for r in recordings)


def with_brief_effects(fit: Fit, recordings: Sequence[Recording], method: Method) -> Fit:
    """Return a fit whose transient errors are not those of effects that act for short times.

    The link of a joint with backlash hits the side of its play whenever its load changes its sign.
    That is not a contact to be left out: it is what shows the play. A drive whose torque is limited
    below its law has such errors at each fast command, friction that builds up at each reversal. If
    a fit has transient errors, that with limits or with backlash on every joint (drives under
    position control), or with friction that builds up, is returned if these are shorter and its
    held-out error is lower.
    """
    brief = OF_DRIVES if follows_commands(fit.model.robot, recordings) else (Presliding.name,)
    judged, least = fit, _left_out(fit, recordings)
    for effect in brief if least > 0.0 else ():
        try:
            model = fit.model.with_effect(effect)
            other = identify(model, recordings, method=method, processing=fit.processing)
        except (IdentificationError, NoSolution):
            continue
        better = np.nanmean(np.log(other.rms_cv / fit.rms_cv)) < 0.0  # else it imitates a contact
        if better and (own := _left_out(other, recordings)) < least:
            judged, least = other, own
    return judged


def _left_out(fit: Fit, recordings: Sequence[Recording]) -> float:
    """Return the time that transient errors of a fit would leave out, s."""
    return sum(e.end - e.start + 2.0 * MARGIN for e in transient_events(fit, recordings))
