"""A fit compared with the recordings of a step, as the page shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.comparison.verdict import verdict
from lieid_casadi.identification import Fit
from lieid_casadi.json_numbers import numbers_or_none
from lieid_casadi.workbench.computing.model_effects import change_rows, effect_rows
from lieid_casadi.workbench.computing.prepared_recordings import NoiseFloor, PreparedRecordings
from lieid_casadi.workbench.computing.results import Evaluation
from lieid_casadi.workbench.state.proposals import ProposedEffect
from lieid_casadi.workbench.state.session import StepErrors

SEARCH_EFFECTS = "“Find what is missing” searches the library of effects"
SEARCH_CHANGES = "“Find what has changed” searches for changes since the fit"


@dataclass(frozen=True)
class Effort:
    """What a fit leaves out, so that its errors can be shown early.

    Attributes
    ----------
    held : bool
        Shape parameters are held.
    thinned : bool
        Only evenly spread parts of the recordings are used.
    brief : bool
        Standard deviations are not computed, and the noise floor is that of the model before.
    """

    held: bool = False
    thinned: bool = False
    brief: bool = False


def evaluate_fit(
    fit: Fit,
    train: PreparedRecordings | None,
    test: PreparedRecordings | None,
    changes: Sequence[ProposedEffect],
    *,
    effort: Effort,
    noise: NoiseFloor | None,
) -> Evaluation:
    """Compare a fit with all recordings of a step.

    Parameters
    ----------
    fit : Fit
    train, test : PreparedRecordings or None
        At least one of them; no training if an opened fit is kept.
    changes : sequence of ProposedEffect
        Since the fit.
    effort : Effort
        Of the fit.
    noise : NoiseFloor or None
        Estimated if None.
    """
    on_train = on_test = None
    if train is not None:
        on_train = train.compared(fit, changes, noise=noise, with_noise=test is None)
    if test is not None:
        on_test = test.compared(fit, changes, noise=noise)
    shown = on_test or on_train
    assert shown is not None
    trained = on_train.rms_moving if on_train is not None else np.full(fit.model.n, np.nan)
    errors = StepErrors(
        tuple(numbers_or_none(trained)),
        tuple(numbers_or_none(fit.rms_cv if on_test is None else on_test.rms_moving)),
        tuple(numbers_or_none(shown.noise_floor)),
    )
    notes = [*fit.warnings, *(on_test.warnings if on_test is not None else ())]
    return Evaluation(
        exact=not (effort.held or effort.thinned),
        complete=effort == Effort(),
        errors=errors,
        train=on_train,
        test=on_test,
        sentence=verdict(shown, remedy=SEARCH_EFFECTS if train else SEARCH_CHANGES),
        effects=effect_rows(fit) + change_rows(changes),
        warnings=tuple(dict.fromkeys(str(w) for w in notes)),
        shapes={s.label: float(v) for s, v in zip(fit.model.shapes, fit.shapes, strict=True)},
        cutoff=fit.processing.cutoff or shown.cutoff,
    )
