"""Diagnose: which effects a model lacks, or what has changed since a fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.comparison import Comparison, compare
from lieid_casadi.diagnosis.diagnosis import Diagnosis, Evidence, Step
from lieid_casadi.diagnosis.residual.projected_residual import Remainder
from lieid_casadi.diagnosis.residual.residual_description import Ahead, described
from lieid_casadi.diagnosis.residual.test_validation import carried_over
from lieid_casadi.diagnosis.residual.unexplained import Unexplained, unexplained
from lieid_casadi.diagnosis.screening.aliases import aliases
from lieid_casadi.diagnosis.screening.context import Scene
from lieid_casadi.diagnosis.search.candidate_selection import FOLD, block_index
from lieid_casadi.diagnosis.search.changed import changed
from lieid_casadi.diagnosis.search.missing_effects import Search
from lieid_casadi.diagnosis.search.pruning import STOOD_IN, stand_ins
from lieid_casadi.diagnosis.search.rivals import FOLDS
from lieid_casadi.diagnosis.search.search_results import Found, Proposal
from lieid_casadi.errors import (
    IdentificationError,
    LieidWarning,
    SameRecordingWarning,
    unique_warnings,
)
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.provenance import Source
from lieid_casadi.identification.regression.fixed_point import ShapeStart
from lieid_casadi.identification.temperature import center_temperature
from lieid_casadi.model import Model
from lieid_casadi.recording import Processing, Recording, period_noise, process

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]


@blas_on_one_thread
def diagnose(
    model: Model | Fit,
    train: Recording | Sequence[Recording],
    test: Recording | Sequence[Recording] | None = None,
    *,
    method: str = "wls",
    processing: Processing | None = None,
    seed: int = 0,
    ask: Callable[[Proposal], bool] | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find which effects a model lacks; of a fit, what has changed since.

    Candidates are chosen within the training recordings; the test confirms each accepted step
    once and chooses nothing.

    Parameters
    ----------
    model : Model or Fit
        With a fit the model is kept as it is, and ``train`` is what was measured since.
    train : Recording or sequence of Recording
    test : Recording or sequence of Recording, optional
        Other motion, so that errors are honest; without it they are cross-validated.
    method : {"wls", "ols", "robust"}
        Of the fits.
    processing : Processing, optional
        Filter options; the cut-off is chosen from the data if not stated.
    seed : int
        For the bootstrap.
    ask : callable, optional
        Called before each step is accepted; False turns it down.
    progress : callable, optional
        Called with a stage's name and the fraction done.

    Raises
    ------
    RecordingError, ModelError, EffectError, IdentificationError
        As `identify` and `compare`.
    """
    report = progress or (lambda stage, fraction: None)
    given, tests = _listed(train), _listed(test)
    if isinstance(model, Fit):
        if test is not None:
            raise IdentificationError(
                "a fit was given: expected the recordings measured since, and no test"
            )
        return changed(model, given, seed=seed, report=report)
    report("identify", 0.0)
    first = identify(model, given, method=method, processing=processing)
    options = first.processing
    segments, _ = center_temperature(process(given, options), first.temperature_mean)
    memory: dict[Fit, Comparison] = {}

    def tested(fit: Fit) -> Comparison | None:
        if tests and fit not in memory:
            memory[fit] = compare(fit, tests)
        return memory.get(fit)

    def judge(fit: Fit) -> Array:
        comparison = tested(fit)
        return np.full(fit.model.n, np.nan) if comparison is None else comparison.rms_moving

    def refit(wanted: Model, start: ShapeStart | None) -> Fit:
        return identify(wanted, given, method=method, processing=options, start=start)

    search = Search(first, segments, refit, judge, seed=seed, ask=ask)
    scene = search.run(lambda stage, fraction: report(stage, 0.1 + 0.8 * fraction))
    report("what stays unexplained", 0.9)
    left = left_over(search, scene, seed=seed)
    out = stand_ins(
        scene,
        search.plain,
        search.first.baseline(search.plain),
        left,
        [found.candidate.placement for found in search.found],
    )
    if out:
        scene = search.without(out, STOOD_IN, scene)
        left = left_over(search, scene, seed=seed)
    ahead = None
    if left and tests:
        others, _ = center_temperature(process(tests, options), first.temperature_mean)
        ahead = Ahead(scene, Scene.of(search.fit, others, tried=False), search.plain)
        left = carried_over(left, scene, ahead.test, search.plain)
    remainder = Remainder.of(scene, search.plain, scene.baseline(search.plain))
    left = described(left, remainder, ahead)
    steps = tuple(_step(found, tested(found.fit), scene) for found in search.found)
    floor, source = _noise_floor(given, search, scene)
    before = tested(first)
    warnings = [*first.warnings, *search.fit.warnings]
    warnings += _same_recording(first, tests)
    if before is not None:
        warnings += before.warnings
    report("done", 1.0)
    return Diagnosis(
        mode="missing",
        verdict=_verdict(steps, left),
        joint_names=tuple(joint.name for joint in model.robot.joints),
        noise_floor=floor,
        noise_source=source,
        baseline_effects=tuple(model.effects),
        baseline_train=first.rms_train,
        baseline_test=None if before is None else before.rms,
        steps=steps,
        unexplained=left,
        rejected=tuple((r.candidate.placement.label, r.reason) for r in search.rejected),
        aliases=aliases(
            search.first.bank.whitened(search.plain, scene.runs),
            search.first.baseline(search.plain),
        ),
        tried=len(scene.bank.candidates) + len(steps),
        fit=search.fit,
        warnings=unique_warnings(warnings),
        train=first.provenance.recordings,
        test=tuple(Source(r.name, r.source_hash) for r in tests),
        baseline_moving=None if before is None else before.rms_moving,
    )


def left_over(search: Search, scene: Scene, *, seed: int) -> tuple[Unexplained, ...]:
    """Return what smooth functions of the signals still explain beside the last model."""
    bank = scene.smooth
    plain = bank.whitened(search.plain, scene.runs), scene.baseline(search.plain)
    white = bank.whitened(search.noise, scene.runs), scene.baseline(search.noise)
    folds = block_index(scene, search.plain, FOLD) % FOLDS
    return unexplained(plain[0], white, plain[1], folds, seed=seed)


def _verdict(steps: Sequence[Step], left: Sequence[Unexplained]) -> str:
    if left:
        return "unexplained"
    return "effect_found" if steps else "sufficient"


def _step(found: Found, test: Comparison | None, scene: Scene) -> Step:
    placement, fit = found.candidate.placement, found.fit
    before, after = found.cross_validated
    joint = int(np.nanargmax(1.0 - after / before))
    parameters = {
        f"{p.name.rpartition('.')[2]}": float(value)
        for p, value in zip(fit.fitted, np.concatenate([fit.values, fit.shapes]), strict=True)
        if p.name.rpartition(".")[0] == placement.effect.label and p.joint == placement.joint
    }
    return Step(
        label=placement.label,
        effect=found.candidate.name,
        joints=found.candidate.joints,
        parameters=parameters,
        rms_train=fit.rms_train,
        rms_test=None if test is None else test.rms,
        moving=None if test is None else test.rms_moving,
        evidence=Evidence(
            log10_p=found.log10_p,
            rows=found.effective_rows,
            effect_size=float(np.sqrt(max(before[joint] ** 2 - after[joint] ** 2, 0.0))),
            held_out_before=float(before[joint]),
            held_out_after=float(after[joint]),
            confirmed=found.confirmed,
        ),
        indistinguishable=found.rivals,
        fit=fit,
    )


def _noise_floor(given: Sequence[Recording], search: Search, scene: Scene) -> tuple[Array, str]:
    """Return the noise (n,) of the filtered torque: from periods, else from the residual."""
    floors = [period_noise(r, cutoff=scene.segments[0].cutoff) for r in given]
    periodic = [(floor, r.duration) for floor, r in zip(floors, given, strict=True)
                if floor is not None]  # fmt: skip
    if periodic:
        squares = [floor**2 for floor, _ in periodic]
        return np.sqrt(np.average(squares, axis=0, weights=[d for _, d in periodic])), "periods"
    return np.array([noise.sigma for noise in search.plain]), "autoregression"


def _same_recording(fit: Fit, tests: Sequence[Recording]) -> list[LieidWarning]:
    seen = {source.sha256 for source in fit.provenance.recordings}
    return [
        SameRecordingWarning(
            f"{r.name or 'the test'} is a training recording too: it confirms nothing"
        )
        for r in tests
        if r.source_hash in seen
    ]


def _listed(recordings: Recording | Sequence[Recording] | None) -> list[Recording]:
    if recordings is None:
        return []
    return [recordings] if isinstance(recordings, Recording) else list(recordings)
