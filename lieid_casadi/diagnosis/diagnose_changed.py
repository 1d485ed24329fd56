"""Diagnosis of what has changed since a fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison import compare
from lieid_casadi.diagnosis.diagnosis import Diagnosis
from lieid_casadi.diagnosis.diagnosis_step import DiagnosisStep
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.residual.error_above_floor import errors_above
from lieid_casadi.diagnosis.residual.projected_residual import ProjectedResidual
from lieid_casadi.diagnosis.residual.residual_description import describe_parts
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.review.late_reversals import late_reversals
from lieid_casadi.diagnosis.review.partial_candidates import with_candidates
from lieid_casadi.diagnosis.review.review import reviewed_parts
from lieid_casadi.diagnosis.screening.aliases import aliases
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.search.changed_effects import ChangedEffects
from lieid_casadi.diagnosis.search.effect_search import search
from lieid_casadi.diagnosis.search.recording_differences import recording_differences
from lieid_casadi.errors import LieidWarning, UnidentifiableWarning, unique_warnings
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.recording import Recording, process


def diagnose_changed(
    fit: Fit,
    recordings: Sequence[Recording],
    *,
    options: DiagnosisOptions,
    seed: int,
    report: Callable[[str, float], None],
) -> Diagnosis:
    """Return what has changed since a fit; see `diagnose` for the parameters.

    Parameters
    ----------
    fit : Fit
    recordings : sequence of Recording
        Measured since the fit.
    options : DiagnosisOptions
    seed : int
        Of the bootstrap.
    report : callable
        Called with a stage's name and the fraction done.
    """
    report("compare", 0.0)
    before = compare(fit, recordings)
    segments, _ = center_temperature(process(recordings, fit.processing), fit.temperature_mean)
    report("search for changes", 0.2)
    context = ScreeningContext.of(fit, segments, options, model_fixed=True)
    problem = ChangedEffects(context, held_out_noise(fit), seed=seed)
    first = problem.errors()
    search(
        problem,
        options.most_changes,
        "most_changes",
        lambda step, fraction: report(step, 0.2 + 0.6 * fraction),
    )
    report("describe the residual", 0.8)
    parts = _unexplained(problem)
    most, expected = options.largest_error_over_expected, problem.expected
    beyond = problem.errors_beyond_uncertainty()
    parts += errors_above(beyond, expected, most, parts)
    uncertain = (problem.errors() > most * expected) & ~(beyond > most * expected)
    steps = tuple(
        DiagnosisStep.of(
            a, confirmed=None, rms_train=None, rms_test=a.errors[1], moving=a.errors[1]
        )
        for a in problem.accepted
    )
    differing = recording_differences(problem)
    report("done", 1.0)
    return Diagnosis(
        mode="changed",
        verdict="unexplained" if parts or differing else "effect_found" if steps else "sufficient",
        joint_names=before.joint_names,
        noise_floor=before.noise_floor,
        noise_source=before.noise_source,
        baseline_effects=tuple(fit.model.effects),
        baseline_train=None,
        baseline_test=before.rms,
        steps=steps,
        unexplained=parts,
        rejected=tuple((r.candidate.placement.label, r.reason) for r in problem.rejected),
        differing=differing,
        aliases=aliases(context.candidates.whitened(problem.white, context.runs), problem.model),
        tried=len(context.candidates.owners),
        fit=fit,
        warnings=unique_warnings(
            [*before.warnings, *_uncertain(problem, uncertain), *late_reversals(problem)]
        ),
        train=fit.provenance.recordings,
        test=before.recordings,
        baseline_moving=first,
        expected=problem.expected,
        limits_reached=tuple(problem.limits_reached),
        seed=seed,
    )


def _unexplained(problem: ChangedEffects) -> tuple[Unexplained, ...]:
    """Return the unexplained parts, after the accepted effects are reviewed."""
    parts = reviewed_parts(problem)
    baseline = problem.current_baseline(problem.white)
    residual = ProjectedResidual.of(problem.context, problem.white, baseline)
    return with_candidates(describe_parts(parts, residual), problem, residual)


def _uncertain(problem: ChangedEffects, joints: NDArray[np.bool_]) -> list[LieidWarning]:
    """Return a warning of each joint (n,) whose large error uncertain parameters explain."""
    errors = problem.errors()
    return [
        UnidentifiableWarning(
            f"joint {j + 1}: the error is {errors[j]:.3g} N·m, expected "
            f"{problem.expected[j]:.3g} N·m; the uncertainty of the fit's parameters explains it. "
            "Fit recordings of larger motion to find smaller changes"
        )
        for j in np.flatnonzero(joints)
    ]


def held_out_noise(fit: Fit) -> tuple[Noise, ...]:
    """Return the noise of each joint's residual, scaled to the fit's held-out error.

    It is not estimated from the new recording, where a slow change would be attributed to the
    correlation of the noise.
    """
    ratio = np.nan_to_num(fit.rms_cv / np.maximum(fit.noise, 1e-300), nan=1.0)
    return tuple(
        n.times(max(float(r), 1.0)) for n, r in zip(fit.residual_noise, ratio, strict=True)
    )
