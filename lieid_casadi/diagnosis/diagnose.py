"""``diagnose``: which effects a model lacks, or what has changed since a fit.

The method, for missing effects (`missing`):

1. Fit the model; leave out contact and faults (`events`), which the final model judges again, and
   in tests alone.
2. Evaluate every effect of the library on every joint on the rows of the fit (`rows`), and what
   changes between recordings or in the course of one; find the path of effects that together
   explain most (`path`), on all rows and on the rows outside each of ten held-out stretches of time
   (`folds`, `search`).
3. Add the effects that lower the error of stretches which their choice did not see (`evidence`), if
   their values are plausible (`candidates`); smooth functions where no effect of the library does.
4. Search again beside them, effects that several joints have on the others alone, and delays where
   friction reverses late; then fit the model with all of them by the procedure of `identify`, try
   variants of friction over speed and rivals of delays, and leave out what does not pass every
   gate: it must lower the held-out error beside the others (`gates`). Of arms under commands limits
   of the drives are searched first, and the simulated motion must be better (`motion`).
5. State each effect with the numbers of this fit: what the error is without it (`steps`), and
   which effects would do as well (`rivals`). These decide the name, not whether it is added.

What has changed since a fit is found by the same search, with the fit's parameters held within
their uncertainty (`changed`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.diagnosis.changed import diagnose_changed
from lieid_casadi.diagnosis.events import leave_out_events, with_brief_effects, without_events
from lieid_casadi.diagnosis.gates import Proposal
from lieid_casadi.diagnosis.missing import diagnose_missing
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.result import Diagnosis
from lieid_casadi.diagnosis.transients import Event, unexplained_events
from lieid_casadi.errors import DropoutWarning, IdentificationError, unique_warnings
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.fit_warnings import held_joints
from lieid_casadi.identification.identify import Method
from lieid_casadi.identification.recording_checks import check_recordings
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

    Whatever lowers the error of data that its choice did not see is in the returned model, whether
    or not its name is certain. A step is ``named`` if the data separate it from every effect of
    another kind, ``one_of`` if other effects would do as well, and ``shape`` if it is a smooth
    function that no effect of the library describes. The test recordings choose nothing.

    Parameters
    ----------
    model : Model, Robot or Fit
        A robot stands for its model without effects. A fit is kept as it is, and ``train`` was
        measured after it.
    train : Recording or sequence of Recording
    test : Recording or sequence of Recording, optional
        Recordings of other motion, on which errors are reported. Not allowed with a fit.
    method : {"ols", "wls", "robust", "feasible"}
        Of the fits.
    processing : Processing, optional
        Filter options; the cut-off frequency is chosen from the data if not stated.
    options : DiagnosisOptions, optional
    seed : int
        Stated in the result; the method draws no random numbers.
    ask : callable, optional
        Called before each effect is added; False rejects it.
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
    chosen = options or DiagnosisOptions()
    recordings, tests = listed(train), [] if test is None else listed(test)
    if isinstance(model, Fit):
        if test is not None:
            raise IdentificationError(
                "a fit was given together with a test; with a fit, expected the recordings "
                "measured after it and no test"
            )
        kept, events = leave_out_events(model, recordings)
        changed = diagnose_changed(model, kept, options=chosen, report=report)
        return _with_events(changed, events, recordings, seed)
    report("identify", 0.0)
    model = as_model(model)
    check_recordings(model, [*recordings, *tests])
    first = identify(model, recordings, method=method, processing=processing)
    kept, events = leave_out_events(with_brief_effects(first, recordings, method), recordings)
    while True:
        fit, left_out = first, any(event.kind != "standstill" for event in events)
        if left_out:
            fit = identify(model, kept, method=method, processing=first.processing)
        found = diagnose_missing(
            fit, kept, tests, method=method, options=chosen, ask=ask, report=report
        )
        standing = unexplained_events(found.fit, recordings, events) if left_out else events
        if len(standing) == len(events):
            events = (*events, *found.events)
            return _with_events(found, events, [*recordings, *tests], seed)
        # effects that the first model lacked looked like contact
        events, kept = standing, without_events(recordings, standing)


def _with_events(
    found: Diagnosis, events: tuple[Event, ...], recordings: Sequence[Recording], seed: int
) -> Diagnosis:
    """Return a diagnosis with the stretches left out, what the recordings lack, and a seed."""
    warnings = [w for w in found.warnings if not isinstance(w, DropoutWarning)]
    gaps = [w for r in recordings for w in check_time(r) if isinstance(w, DropoutWarning)]
    held = held_joints(found.fit, recordings)
    every = unique_warnings([*warnings, *gaps, *held])
    return replace(found, events=events, warnings=every, seed=seed)
