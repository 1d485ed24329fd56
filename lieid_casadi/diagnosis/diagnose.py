"""``diagnose``: which effects a model lacks, or what has changed since a fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.diagnosis.diagnose_changed import diagnose_changed
from lieid_casadi.diagnosis.diagnose_missing import diagnose_missing
from lieid_casadi.diagnosis.diagnosis import Diagnosis
from lieid_casadi.diagnosis.events.brief_effects import with_brief_effects
from lieid_casadi.diagnosis.events.event import Event
from lieid_casadi.diagnosis.events.held_joints import held_joints
from lieid_casadi.diagnosis.events.leave_out import leave_out_events
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.search.search_results import Proposal
from lieid_casadi.errors import DropoutWarning, IdentificationError, unique_warnings
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.identify import Method
from lieid_casadi.model import Model, as_model
from lieid_casadi.recording import Processing, Recording
from lieid_casadi.recording.plausibility import check_time
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot import Robot


@blas_on_one_thread
def diagnose(
    model: Model | Robot | Fit,
    train: Recording | Sequence[Recording],
    test: Recording | Sequence[Recording] | None = None,
    *,
    method: Method = "wls",
    processing: Processing | None = None,
    options: DiagnosisOptions | None = None,
    seed: int = 0,
    ask: Callable[[Proposal], bool] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """Find the effects that a model lacks or, given a fit, what has changed since.

    The test recordings choose nothing: steps and unexplained parts are the same with them and
    without. An effect must reduce the error of every held-out part of the training recordings that
    can judge it: of each recording, or of blocks of time where there is only one.

    Parameters
    ----------
    model : Model, Robot or Fit
        A robot stands for its model without effects. A fit is kept as it is, and ``train`` was
        measured after it.
    train : Recording or sequence of Recording
    test : Recording or sequence of Recording, optional
        Recordings of other motion, on which errors are reported. Not allowed with a fit.
    method : {"ols", "wls", "robust"}
        Of the fits.
    processing : Processing, optional
        Filter options; the cut-off frequency is chosen from the data if not stated.
    options : DiagnosisOptions, optional
        Thresholds.
    seed : int
        Of the bootstrap.
    ask : callable, optional
        Called before each step is accepted; False rejects it.
    progress : callable, optional
        Called with the name of a stage and the fraction done, 0 to 1.

    Returns
    -------
    Diagnosis

    Raises
    ------
    RecordingError, ModelError, EffectError, IdentificationError
        As `identify` and `compare`; a fit together with a test.
    """
    report = progress or (lambda stage, fraction: None)
    thresholds = options or DiagnosisOptions()
    recordings, tests = listed(train), [] if test is None else listed(test)
    if isinstance(model, Fit):
        if test is not None:
            raise IdentificationError(
                "a fit was given together with a test; with a fit, expected the recordings "
                "measured after it and no test"
            )
        kept, events = leave_out_events(model, recordings, thresholds)
        changed = diagnose_changed(model, kept, options=thresholds, seed=seed, report=report)
        return _with_events(changed, events, recordings)
    report("identify", 0.0)
    first = identify(as_model(model), recordings, method=method, processing=processing)
    judged = with_brief_effects(first, recordings, method, thresholds)
    kept, events = leave_out_events(judged, recordings, thresholds)
    if any(event.kind != "standstill" for event in events):
        first = identify(as_model(model), kept, method=method, processing=first.processing)
    kept_tests, test_events = leave_out_events(judged, tests, thresholds) if tests else ([], ())
    missing = diagnose_missing(
        first,
        kept,
        kept_tests,
        method=method,
        options=thresholds,
        seed=seed,
        ask=ask,
        report=report,
    )
    return _with_events(missing, (*events, *test_events), [*recordings, *tests])


def _with_events(
    found: Diagnosis, events: tuple[Event, ...], recordings: Sequence[Recording]
) -> Diagnosis:
    """Return a diagnosis with the stretches left out; an arm at rest is not judged sufficient.

    Warnings of gaps are those of the recordings as they were given.

    Parameters
    ----------
    found : Diagnosis
        Of the rest of the recordings.
    events : tuple of Event
    recordings : sequence of Recording
        As they were given.
    """
    resting = any(len(e.joints) == found.fit.model.n for e in events if e.kind == "standstill")
    warnings = [w for w in found.warnings if not isinstance(w, DropoutWarning)]
    gaps = [w for r in recordings for w in check_time(r) if isinstance(w, DropoutWarning)]
    held = held_joints(found.fit, recordings)
    return replace(
        found,
        events=events,
        verdict="unexplained" if resting else found.verdict,
        warnings=unique_warnings([*warnings, *gaps, *held]),
    )
