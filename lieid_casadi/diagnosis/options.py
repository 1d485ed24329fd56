"""Options of the diagnosis; `docs/method/thresholds.md` shows what moves with each of them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DiagnosisOptions:
    """Options of :func:`lieid_casadi.diagnose`."""

    #: Penalty of a parameter in a path, in log N of a weighted sum of squares.
    penalty: float = 1.0
    #: Effects of a path at most.
    most_steps: int = 30
    #: Effective number of rows that make up a column, (Σc²)²/Σc⁴. With fewer a single disturbance
    #: decides the coefficient.
    least_support: float = 5.0
    #: Refinements of grids of shape parameters.
    refinements: int = 1
    #: Held-out parts.
    folds: int = 10
    #: Standard errors by which the mean gain on held-out parts must exceed zero.
    gain_deviations: float = 2.0
    #: Least relative fall of the held-out error of a joint.
    worth: float = 0.03
    #: Least fraction of the paths without a held-out part in which a named effect is selected.
    least_selected: float = 0.7
    #: Standard errors by which an effect must be better than a rival to be named.
    rival_deviations: float = 2.0
    #: Error in motion relative to the noise floor above which a model is not sufficient.
    largest_error: float = 1.5
    #: Error of a kept model relative to its expected one above which something has changed.
    least_misfit: float = 1.15
    #: Least relative fall of a joint's error by a change since a fit.
    worth_of_change: float = 0.1
    #: Error of a kept model relative to its expected one above which it is not explained.
    largest_change: float = 3.0
