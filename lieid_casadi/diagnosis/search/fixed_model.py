"""Baselines of a model that is not fitted again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.held_out import HeldOut
from lieid_casadi.diagnosis.screening.model_factor import ModelFactor
from lieid_casadi.diagnosis.search.candidate_selection import LEAST_OWN_PART
from lieid_casadi.diagnosis.search.parameter_checks import implausible_size, unresolved_point
from lieid_casadi.diagnosis.search.search_problem import Offer
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.recording import Processed

#: Relative to the largest variance: below it a parameter counts as exactly known.
LEAST_VARIANCE = 1e-12

Array = NDArray[np.float64]


def fixed_parameters(
    candidate: Candidate, point: Array, baseline: Baseline, columns: Array
) -> dict[str, float]:
    """Return the coefficients of columns, and the shape parameters of a grid point.

    Parameters
    ----------
    candidate : Candidate
    point : (s,)
        Of its grid.
    baseline : Baseline
    columns : (R, k)
        Whitened as the baseline is.
    """
    values = baseline.coefficients(columns, least=LEAST_OWN_PART)
    effect = candidate.effect
    coefficients = {c.name: float(v) for c, v in zip(effect.coefficients, values, strict=True)}
    shapes = point[: len(effect.shapes)]
    return coefficients | {s.name: float(v) for s, v in zip(effect.shapes, shapes, strict=True)}


def implausible_offer(
    offer: Offer, segments: Sequence[Processed], options: DiagnosisOptions
) -> str:
    """Return which parameter is not resolved, or larger than on any real arm; empty if none.

    Parameters
    ----------
    offer : Offer
    segments : sequence of Processed
    options : DiagnosisOptions
    """
    candidate = offer.candidate
    point = candidate.grid[offer.state.candidates.point[offer.group]]
    with_others = offer.state.with_groups(offer.others)
    parameters = fixed_parameters(candidate, point, with_others, offer.columns)
    return unresolved_point(candidate, point, segments, options) or implausible_size(
        candidate.effect, parameters
    )


def unconfirmed(held_out: HeldOut, *, alone: bool) -> str:
    """Return why held-out data do not confirm a change, or an empty text.

    Beside the rule of `HeldOut`, the error must also fall without the block of time where it falls
    most. Otherwise a few samples support the change, for example those of one reversal at which
    the sign of the velocity is wrong. Recordings may differ in what they excite, so that one of
    several suffices. Beside another change of its joint, some part must be able to judge it: the
    other one may describe its own torque at reversals with an error.

    Parameters
    ----------
    held_out : HeldOut
    alone : bool
        Whether no other change of the joint is accepted.
    """
    gain, parts = held_out.gain, held_out.parts
    if held_out.reason:
        return held_out.reason
    if not (alone or held_out.is_confirmed):
        return "its effect on each held-out part is within the noise"
    if not parts.recordings and gain.sum() <= gain.max():
        return f"the error of held-out data falls on {parts.names[int(np.argmax(gain))]} alone"
    return ""


def without_columns(context: ScreeningContext, noise: Sequence[Noise]) -> Baseline:
    """Return the residual of a model whose parameters cannot move."""
    residuals = context.whitened(noise, context.residual)
    ends = np.concatenate([[0], np.cumsum([len(r) for r in residuals])]).astype(np.intp)
    empty = np.zeros((ends[-1], 0))
    return Baseline(empty, np.zeros((0, 0)), empty, np.concatenate(residuals), ends)


def with_prior(context: ScreeningContext, noise: Sequence[Noise]) -> Baseline:
    """Return the baseline of a model whose parameters may move within their uncertainty."""
    fit = context.fit
    count = len(fit.values) + len(fit.shapes)
    sizes, axes = np.linalg.eigh(fit.covariance[:count, :count])
    least = LEAST_VARIANCE * max(float(sizes.max(initial=0.0)), 1e-300)
    prior = (axes / np.sqrt(np.maximum(sizes, least))).T
    matrices = context.whitened(noise, context.model_columns)
    residuals = context.whitened(noise, context.residual)
    return ModelFactor.of([*matrices, prior], [*residuals, np.zeros(count)]).baseline()


def rms_by_joint(baseline: Baseline, n: int, further: Array | float = 0.0) -> Array:
    """Return the RMS of the residual of each of n joints (n,), whitened; 0 without rows.

    Parameters
    ----------
    baseline : Baseline
    n : int
        Number of joints.
    further : (R,) or 0
        Added to the residual.
    """
    rest = baseline.residual + further
    rows = [rest[baseline.joint(j)] for j in range(n)]
    return np.array([np.sqrt(np.mean(own**2)) if len(own) else 0.0 for own in rows])


def relative_fall(baseline: Baseline, columns: Array, n: int) -> Array:
    """Return the relative fall (n,) of each joint's error that columns cause; 0 without rows.

    Of the model within its uncertainty and with the columns, the error is compared with what it
    is without the torque of the columns. So neither an error that the uncertain parameters explain
    on other motion hides a change, nor do these parameters take the place of its torque.

    Parameters
    ----------
    baseline : Baseline
        Without the columns.
    columns : (R, k)
        Whitened as the baseline is.
    n : int
        Number of joints.
    """
    torque = baseline.padded(columns) @ baseline.coefficients(columns, least=LEAST_OWN_PART)
    complete = baseline.with_columns(columns)
    before, after = rms_by_joint(complete, n, torque), rms_by_joint(complete, n)
    return 1.0 - np.divide(after, before, out=np.ones(n), where=before > 0.0)
