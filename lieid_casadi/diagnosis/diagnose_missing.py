"""Diagnosis of the effects that a model lacks."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison import Comparison, compare
from lieid_casadi.diagnosis.diagnosis import Diagnosis
from lieid_casadi.diagnosis.diagnosis_step import DiagnosisStep
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.residual.projected_residual import ProjectedResidual
from lieid_casadi.diagnosis.residual.residual_description import describe_parts
from lieid_casadi.diagnosis.residual.test_validation import TrainAndTest, confirmed_parts
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.aliases import Aliases, aliases
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.search.effect_search import unexplained_parts
from lieid_casadi.diagnosis.search.missing_effects import MissingEffects
from lieid_casadi.diagnosis.search.pruning import PARTIAL, partial_effects
from lieid_casadi.diagnosis.search.search_results import Proposal
from lieid_casadi.errors import LieidWarning, SameRecordingWarning, unique_warnings
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.identify import Method
from lieid_casadi.identification.provenance import Source
from lieid_casadi.identification.regression.fixed_point import ShapeStart
from lieid_casadi.identification.temperature import center_temperature
from lieid_casadi.model import Model
from lieid_casadi.recording import Processing, Recording, process

Array = NDArray[np.float64]


def diagnose_missing(
    model: Model,
    train: Sequence[Recording],
    tests: Sequence[Recording],
    *,
    method: Method,
    processing: Processing | None,
    options: DiagnosisOptions,
    seed: int,
    ask: Callable[[Proposal], bool] | None,
    report: Callable[[str, float], None],
) -> Diagnosis:
    """Return the effects that a model lacks; see `diagnose` for the parameters.

    Parameters
    ----------
    model : Model
    train, tests : sequence of Recording
    method : {"ols", "wls", "robust", "feasible"}
        Of the fits.
    processing : Processing or None
    options : DiagnosisOptions
    seed : int
        Of the bootstrap.
    ask : callable or None
        Called before each step is accepted; False rejects it.
    report : callable
        Called with a stage's name and the fraction done.
    """
    report("identify", 0.0)
    first = identify(model, train, method=method, processing=processing)
    processing = first.processing
    segments, _ = center_temperature(process(train, processing), first.temperature_mean)
    comparisons = FitComparisons(tests)

    def refit(larger: Model, start: ShapeStart | None) -> Fit:
        return identify(larger, train, method=method, processing=processing, start=start)

    problem = MissingEffects(
        first, segments, refit, comparisons.error, options=options, seed=seed, ask=ask
    )
    problem.run(lambda fraction: report("search for missing effects", 0.1 + 0.8 * fraction))
    report("describe the residual", 0.9)
    parts = _unexplained(problem, tests)
    steps = _steps(problem, comparisons)
    before = comparisons.of(first)
    last = comparisons.of(problem.fit) or compare(problem.fit, train)
    report("done", 1.0)
    return Diagnosis(
        mode="missing",
        verdict="unexplained" if parts else "effect_found" if steps else "sufficient",
        joint_names=tuple(joint.name for joint in model.robot.joints),
        noise_floor=last.noise_floor,
        noise_source=last.noise_source,
        baseline_effects=tuple(model.effects),
        baseline_train=first.rms_train,
        baseline_test=None if before is None else before.rms,
        steps=steps,
        unexplained=parts,
        rejected=tuple((r.candidate.placement.label, r.reason) for r in problem.rejected),
        aliases=_aliases(problem),
        tried=len(problem.context.candidates.owners) + len(steps),
        fit=problem.fit,
        warnings=_warnings(problem, before, tests),
        train=first.provenance.recordings,
        test=tuple(Source(r.name, r.source_hash) for r in tests),
        baseline_moving=None if before is None else before.rms_moving,
        limits_reached=tuple(problem.limits_reached),
    )


class FitComparisons:
    """Comparisons of fits with the test recordings, each computed once.

    Parameters
    ----------
    tests : sequence of Recording
        May be empty.
    """

    def __init__(self, tests: Sequence[Recording]) -> None:
        self._tests, self._compared = tests, dict[Fit, Comparison]()

    def of(self, fit: Fit) -> Comparison | None:
        """Return the comparison of a fit, None without a test."""
        if self._tests and fit not in self._compared:
            self._compared[fit] = compare(fit, self._tests)
        return self._compared.get(fit)

    def error(self, fit: Fit) -> Array:
        """Return the error of joints in motion (n,), N·m; NaN without a test."""
        comparison = self.of(fit)
        return np.full(fit.model.n, np.nan) if comparison is None else comparison.rms_moving


def _steps(problem: MissingEffects, comparisons: FitComparisons) -> tuple[DiagnosisStep, ...]:
    steps = []
    for accepted in problem.accepted:
        assert accepted.fit is not None
        test = comparisons.of(accepted.fit)
        steps.append(
            DiagnosisStep.of(
                accepted,
                rms_train=accepted.fit.rms_train,
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
    return unique_warnings([*warnings, *(() if before is None else before.warnings)])


def _unexplained(problem: MissingEffects, tests: Sequence[Recording]) -> tuple[Unexplained, ...]:
    """Return the unexplained parts, after effects that only partly explain them are removed."""
    parts = unexplained_parts(problem)
    partial = partial_effects(problem, parts)
    if partial:
        problem.remove(partial, PARTIAL)
        parts = unexplained_parts(problem)
    context, white = problem.context, problem.white
    recordings = None
    if parts and tests:
        fit = problem.fit
        segments = process(tests, fit.processing)
        others, _ = center_temperature(segments, problem.first.fit.temperature_mean)
        test = ScreeningContext.of(fit, others, context.options, with_candidates=False)
        recordings = TrainAndTest(context, test, white)
        parts = confirmed_parts(parts, recordings)
    residual = ProjectedResidual.of(context, white, context.baseline(white))
    return describe_parts(parts, residual, recordings)


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
