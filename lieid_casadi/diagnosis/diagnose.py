"""``diagnose``: which effects a model lacks, or what has changed since a fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.diagnosis.diagnose_changed import diagnose_changed
from lieid_casadi.diagnosis.diagnose_missing import diagnose_missing
from lieid_casadi.diagnosis.diagnosis import Diagnosis
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.search.search_results import Proposal
from lieid_casadi.errors import IdentificationError
from lieid_casadi.identification import Fit
from lieid_casadi.identification.identify import Method
from lieid_casadi.model import Model, as_model
from lieid_casadi.recording import Processing, Recording
from lieid_casadi.recording.given_recordings import listed
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

    Candidates are selected on the training recordings. A step is not accepted if the error on the
    test rises.

    Parameters
    ----------
    model : Model, Robot or Fit
        A robot stands for its model without effects. A fit is kept as it is, and ``train`` was
        measured after it.
    train : Recording or sequence of Recording
    test : Recording or sequence of Recording, optional
        Recordings of other motion. Without them errors are cross-validated. Not allowed with a
        fit.
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
        return diagnose_changed(model, recordings, options=thresholds, seed=seed, report=report)
    return diagnose_missing(
        as_model(model),
        recordings,
        tests,
        method=method,
        processing=processing,
        options=thresholds,
        seed=seed,
        ask=ask,
        report=report,
    )
