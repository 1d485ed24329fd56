"""Diagnosis of the effects that a model lacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison import Comparison, compare
from lieid_casadi.comparison.compare import compare_segments, compared_segments
from lieid_casadi.compiled import compile
from lieid_casadi.diagnosis.diagnosis import Diagnosis
from lieid_casadi.diagnosis.diagnosis_step import DiagnosisStep
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.residual.error_above_floor import errors_above
from lieid_casadi.diagnosis.residual.projected_residual import ProjectedResidual
from lieid_casadi.diagnosis.residual.residual_description import describe_parts
from lieid_casadi.diagnosis.residual.test_results import TrainAndTest, with_test_results
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.review.late_reversals import late_reversals
from lieid_casadi.diagnosis.review.partial_candidates import with_candidates
from lieid_casadi.diagnosis.review.review import exchange_rivals, reviewed_parts
from lieid_casadi.diagnosis.screening.aliases import Aliases, aliases
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.search.missing_effects import MissingEffects
from lieid_casadi.diagnosis.search.recording_differences import (
    leading_difference,
    recording_differences,
)
from lieid_casadi.diagnosis.search.search_results import Difference, Proposal
from lieid_casadi.errors import LieidWarning, SameRecordingWarning, unique_warnings
from lieid_casadi.identification import Fit
from lieid_casadi.identification.identify import Method, identify_segments
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.identification.regression.design_matrix import FilteredColumns
from lieid_casadi.identification.regression.fixed_point import ShapeStart
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording, process

Array = NDArray[np.float64]


def diagnose_missing(
    first: Fit,
    train: Sequence[Recording],
    tests: Sequence[Recording],
    *,
    method: Method,
    options: DiagnosisOptions,
    seed: int,
    ask: Callable[[Proposal], bool] | None,
    report: Callable[[str, float], None],
) -> Diagnosis:
    """Return the effects that a model lacks; see `diagnose` for the parameters.

    Parameters
    ----------
    first : Fit
        Of the model before any effect is added.
    train, tests : sequence of Recording
    method : {"ols", "wls", "robust", "feasible"}
        Of the fits.
    options : DiagnosisOptions
    seed : int
        Of the bootstrap.
    ask : callable or None
        Called before each step is accepted; False rejects it.
    report : callable
        Called with a stage's name and the fraction done.
    """
    problem, leading = _problem(first, train, method=method, options=options, seed=seed, ask=ask)
    _search(problem, report)
    parts = _unexplained(problem, tests)
    problem.complete()
    compared = _comparisons(problem, tests)
    steps = _steps(problem, compared)
    before, fitted = compared.get(first), compare(problem.fit, train)
    last = compared.get(problem.fit, fitted)
    most = options.largest_error_over_floor
    parts += errors_above(problem.fit.rms_cv, fitted.noise_floor, most, parts)
    differing = leading + recording_differences(problem)
    report("done", 1.0)
    return Diagnosis(
        mode="missing",
        verdict="unexplained" if parts or differing else "effect_found" if steps else "sufficient",
        joint_names=tuple(joint.name for joint in first.model.robot.joints),
        noise_floor=last.noise_floor,
        noise_source=last.noise_source,
        baseline_effects=tuple(first.model.effects),
        baseline_train=first.rms_train,
        baseline_test=None if before is None else before.rms,
        steps=steps,
        unexplained=parts,
        rejected=tuple((r.candidate.placement.label, r.reason) for r in problem.rejected),
        differing=differing,
        aliases=_aliases(problem),
        tried=len(problem.context.candidates.owners) + len(steps),
        fit=problem.fit,
        warnings=_warnings(problem, before, tests),
        train=first.provenance.recordings,
        test=tuple(Source(r.name, r.source_hash) for r in tests),
        baseline_moving=None if before is None else before.rms_moving,
        baseline_cv=first.rms_cv,
        limits_reached=tuple(problem.limits_reached),
        seed=seed,
    )


def _problem(
    first: Fit,
    train: Sequence[Recording],
    *,
    method: Method,
    options: DiagnosisOptions,
    seed: int,
    ask: Callable[[Proposal], bool] | None,
) -> tuple[MissingEffects, tuple[Difference, ...]]:
    """Return the search problem, and leading differences between the recordings, set apart in it.

    The parameters are those of `diagnose_missing`.
    """
    segments, _ = center_temperature(process(train, first.processing), first.temperature_mean)
    known = tuple(FilteredColumns() for _ in segments)

    def refit(larger: Model, start: ShapeStart, *, uncertainty: bool = False) -> Fit:
        return identify_segments(
            compile(larger),
            segments,
            method=method,
            start=start,
            uncertainty=uncertainty,
            known=known,
            temperature_mean=first.temperature_mean,
            provenance=first.provenance,
        )

    context = ScreeningContext.of(first, segments, options, known=known)
    problem = MissingEffects(context, refit, seed=seed, ask=ask)
    leading: tuple[Difference, ...] = ()
    while (difference := leading_difference(problem)) is not None:
        leading += difference[0]
        context = context.with_apart(difference[1])
        problem = MissingEffects(context, refit, seed=seed, ask=ask)
    return problem, leading


def _search(problem: MissingEffects, report: Callable[[str, float], None]) -> None:
    """Add effects, and fit all their shape parameters."""
    problem.run(lambda step, fraction: report(step, 0.1 + 0.8 * fraction))
    if len(problem.fit.shapes):  # rivals are compared before a fit that takes longer than any step
        report("compare rivals", 0.9)
        exchange_rivals(problem)
        problem.fit_shapes()
    report("describe the residual", 0.95)


def _comparisons(problem: MissingEffects, tests: Sequence[Recording]) -> dict[Fit, Comparison]:
    """Return the comparison of each fit with the test recordings; none without a test.

    The noise floor, which takes as long as the rest, is that of the first and of the last fit.
    """
    if not tests:
        return {}
    first = problem.first.fit
    found = {fit: compare(fit, tests) for fit in dict.fromkeys((first, problem.fit))}
    segments = compared_segments(first, tests)
    for fit in {accepted.fit for accepted in problem.accepted} - found.keys():
        assert fit is not None
        found[fit] = compare_segments(fit, tests, segments, with_noise=False)
    return found


def _steps(
    problem: MissingEffects, compared: Mapping[Fit, Comparison]
) -> tuple[DiagnosisStep, ...]:
    steps = []
    before = last = problem.first.fit
    for accepted in problem.accepted:
        assert accepted.fit is not None
        if accepted.fit is not last:  # members of a family share a fit
            before, last = last, accepted.fit
        test, earlier = compared.get(last), compared.get(before)
        confirmed = None
        if test is not None and earlier is not None:
            confirmed = bool(test.rms_moving[accepted.joint] < earlier.rms_moving[accepted.joint])
        steps.append(
            DiagnosisStep.of(
                accepted,
                confirmed=confirmed,
                rms_train=last.rms_train,
                rms_test=None if test is None else test.rms,
                moving=None if test is None else test.rms_moving,
            )
        )
    return tuple(steps)


def _warnings(
    problem: MissingEffects, before: Comparison | None, tests: Sequence[Recording]
) -> tuple[LieidWarning, ...]:
    """Return the warnings of the first and the last fit and of the test, each once."""
    first = problem.first.fit
    warnings = [*first.warnings, *problem.fit.warnings, *_same_recording(first, tests)]
    warnings += late_reversals(problem)
    return unique_warnings([*warnings, *(() if before is None else before.warnings)])


def _unexplained(problem: MissingEffects, tests: Sequence[Recording]) -> tuple[Unexplained, ...]:
    """Return the unexplained parts, after the accepted effects are reviewed."""
    parts = reviewed_parts(problem)
    context, white = problem.context, problem.white
    residual = ProjectedResidual.of(context, white, context.baseline(white))
    parts = with_candidates(describe_parts(parts, residual), problem, residual)
    if not parts or not tests:
        return parts
    segments = process(tests, problem.fit.processing)
    others, _ = center_temperature(segments, problem.first.fit.temperature_mean)
    test = ScreeningContext.of(problem.fit, others, context.options, with_candidates=False)
    if context.apart:  # columns of training recordings only
        pairs = zip(test.torque, context.apart, strict=True)
        test = test.with_apart([np.zeros((len(own), a.shape[1])) for own, a in pairs])
    return with_test_results(parts, TrainAndTest(context, test, white))


def _aliases(problem: MissingEffects) -> Aliases:
    """Return the candidates that cannot be identified in addition to the first model."""
    candidates = problem.first.candidates.whitened(problem.white, problem.first.runs)
    return aliases(candidates, problem.first.baseline(problem.white))


def _same_recording(fit: Fit, tests: Sequence[Recording]) -> list[LieidWarning]:
    seen = {source.sha256 for source in fit.provenance.recordings}
    return [
        SameRecordingWarning(
            f"the test {r.name or 'recording'} is also a training recording, so that it cannot "
            "confirm the result; use a recording of other motion"
        )
        for r in tests
        if r.source_hash in seen
    ]
