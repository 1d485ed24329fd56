"""Recordings without the stretches that say nothing about the arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lieid_casadi.diagnosis.events.event import Event
from lieid_casadi.errors import RecordingError
from lieid_casadi.recording import Recording
from lieid_casadi.recording.measurement import OPTIONAL_SIGNALS
from lieid_casadi.recording.sample_timing import gap_limit

MARGIN = 0.1  # s on both sides of an event


def without_events(recordings: Sequence[Recording], events: Sequence[Event]) -> list[Recording]:
    """Return the recordings without the stretches of contact and faults.

    The gap that remains divides a recording into segments, which are never joined.

    Parameters
    ----------
    recordings : sequence of Recording
    events : sequence of Event
        Those of other recordings are ignored; standstill is kept.

    Raises
    ------
    RecordingError
        Nothing remains.
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
    if keep.all():
        return recording
    signals: dict[str, Any] = {
        field: None if values is None else values[keep]
        for field in OPTIONAL_SIGNALS
        for values in [getattr(recording, field)]
    }
    labels = recording.payload_label
    if labels is not None:
        labels = tuple(label for label, use in zip(labels, keep, strict=True) if use)
    return replace(
        recording, t=recording.t[keep], q=recording.q[keep], payload_label=labels, **signals
    )
