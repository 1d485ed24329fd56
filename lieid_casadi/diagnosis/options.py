"""Options of the diagnosis; `docs/method/thresholds.md` shows what moves with each of them.

Every comment ends with the source. *Statistics*: a convention or the cited theory. *Resolution*:
what sampling, filtering or rounding permits. *Simulations*: set on the half ``tune`` of the
benchmark of hidden effects. *Cost*: a larger number takes longer.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DiagnosisOptions:
    """Options of :func:`lieid_casadi.diagnose`."""

    #: Penalty of a parameter in a path, in log N of a weighted sum of squares. Statistics: Schwarz,
    #: Annals of Statistics 1978.
    penalty: float = 1.0
    #: Effects of a path at most, which is reported. Cost.
    most_steps: int = 30
    #: Held-out parts. Statistics: ten is usual for cross-validation.
    folds: int = 10
    #: Standard errors by which the mean gain on held-out parts, and the coefficients, must exceed
    #: zero. Statistics: about 95 %.
    gain_deviations: float = 2.0
    #: Standard errors by which both must exceed zero for the effect to be named. Statistics: 99 %
    #: of Student's t of ten parts; hundreds of candidates are compared.
    name_deviations: float = 3.0
    #: Least relative fall of the held-out error of a joint (`--worth`). Simulations.
    worth: float = 0.03
    #: Standard errors by which an effect must be better than a rival to be named. Statistics:
    #: Vuong, Econometrica 1989.
    rival_deviations: float = 2.0
    #: Error in motion above which a model is not sufficient, relative to the noise floor or, of a
    #: kept model, to noise and reversals. Simulations: complete models stay below it.
    largest_error: float = 1.5
    #: Least relative fall of a joint's error by a change since a fit. Simulations.
    worth_of_change: float = 0.1
