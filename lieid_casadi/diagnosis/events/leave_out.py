"""Find the stretches of recordings that say nothing about the arm, and leave them out."""

from __future__ import annotations

from collections.abc import Sequence

from lieid_casadi.diagnosis.events.detection import transient_events
from lieid_casadi.diagnosis.events.event import Event
from lieid_casadi.diagnosis.events.exclusion import without_events
from lieid_casadi.diagnosis.events.standstill import standstill_events
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.identification import Fit
from lieid_casadi.identification.recording_checks import check_recordings
from lieid_casadi.recording import Recording, process


def leave_out_events(
    fit: Fit, recordings: Sequence[Recording], options: DiagnosisOptions
) -> tuple[list[Recording], tuple[Event, ...]]:
    """Return recordings without contact and faults, and these events and joints at rest.

    Parameters
    ----------
    fit : Fit
        Whose errors are examined.
    recordings : sequence of Recording
    options : DiagnosisOptions

    Raises
    ------
    RecordingError, ModelError, EffectError
        A recording that the fit cannot be compared with; nothing remains.
    """
    check_recordings(fit.model, recordings)
    events = transient_events(fit, recordings, options)
    kept = without_events(recordings, events)
    segments = process(kept, fit.processing)
    still = standstill_events(fit.model.robot, segments, options.least_motion)
    return kept, (*events, *still)
