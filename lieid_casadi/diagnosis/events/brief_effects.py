"""Effects that act for short times: a fit without them seems to show contact."""

from __future__ import annotations

from collections.abc import Sequence

from lieid_casadi.diagnosis.events.detection import transient_events
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.effects.backlash import Backlash
from lieid_casadi.errors import IdentificationError
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.identify import Method
from lieid_casadi.recording import Recording
from lieid_casadi.recording.conversion import is_torque_of_laws


def with_brief_effects(
    fit: Fit, recordings: Sequence[Recording], method: Method, options: DiagnosisOptions
) -> Fit:
    """Return a fit whose transient errors are not those of effects that act for short times.

    The link of a joint with backlash hits the side of its play whenever its load changes its sign.
    That is not a contact to be left out: it is what shows the play. If a fit of a drive under
    position control has transient errors, they are therefore judged with backlash on every joint.

    Parameters
    ----------
    fit : Fit
    recordings : sequence of Recording
        To which it was fitted.
    method : {"ols", "wls", "robust", "feasible"}
        Of the fit.
    options : DiagnosisOptions
    """
    drives = fit.model.robot.drives
    if drives is None or not all(is_torque_of_laws(r, drives) for r in recordings):
        return fit
    if not any(e.kind == "contact" for e in transient_events(fit, recordings, options)):
        return fit
    model = fit.model.with_effect(Backlash.name)
    try:
        return identify(model, recordings, method=method, processing=fit.processing)
    except IdentificationError:
        return fit
