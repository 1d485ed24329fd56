"""``diagnose``: which effects a model lacks, or what has changed since a fit.

The method, for missing effects:

1. Fit the model; leave out contact and faults (`events`).
2. Evaluate every effect of the library on every joint on the rows of the fit (`rows`), and find the
   path of effects that together explain most (`path`), on all rows and on the rows outside each of
   ten held-out stretches of time (`folds`).
3. Add the effects that lower the error of stretches which their choice did not see (`nested`), if
   their values are plausible (`gates`); smooth functions where no effect of the library does.
4. Fit the model with them, by the procedure of `identify`; search again, beside them, until nothing
   is added. Remove what the final model does not need.
5. State each effect with the numbers of the final fit: what the error is without it (`falls`), and
   which effects would do as well (`rivals`). These decide the name, not whether it is added.

What has changed since a fit is found by the same search, with the fit's parameters held within
their uncertainty (`changed`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.comparison import Comparison, compare
from lieid_casadi.comparison.compare import compared_segments
from lieid_casadi.compiled import compile
from lieid_casadi.diagnosis.changed import diagnose_changed
from lieid_casadi.diagnosis.events import held_joints, leave_out_events, with_brief_effects
from lieid_casadi.diagnosis.falls import FinalModel
from lieid_casadi.diagnosis.gates import reason_against
from lieid_casadi.diagnosis.nested import Slot
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.result import Diagnosis
from lieid_casadi.diagnosis.rivals import represented
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.search import SMOOTH, Round, search
from lieid_casadi.diagnosis.step import Difference
from lieid_casadi.diagnosis.steps import (
    Accepted,
    absorbed_and_weak,
    fitted_values,
    late_friction,
    steps_of,
    unexplained_parts,
)
from lieid_casadi.diagnosis.transients import Event
from lieid_casadi.effects import Placement
from lieid_casadi.errors import (
    DropoutWarning,
    IdentificationError,
    SameRecordingWarning,
    unique_warnings,
)
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.identify import Method, identify_segments
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.identification.regression.design_matrix import FilteredColumns
from lieid_casadi.model import Model, as_model
from lieid_casadi.recording import Processed, Processing, Recording, process
from lieid_casadi.recording.plausibility import check_time
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot import Robot

Report = Callable[[str, float], None]
ROUNDS = 2  # of search and fit; the second one adds what the first fit hid


@dataclass(frozen=True)
class Proposal:
    """An effect that is about to be added; ``before`` and ``after`` are held-out errors, N·m."""

    label: str
    joint: int
    before: float
    after: float


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
    progress: Report | None = None,
) -> Diagnosis:
    """Find the effects that a model lacks or, given a fit, what has changed since.

    Whatever lowers the error of data that its choice did not see is in the returned model, whether
    or not its name is certain. A step is ``named`` if the data separate it from every effect of
    another kind, ``one_of`` if other effects would do as well, and ``shape`` if it is a smooth
    function that no effect of the library describes. The test recordings choose nothing.

    Parameters
    ----------
    model : Model, Robot or Fit
        A robot stands for its model without effects. A fit is kept as it is, and ``train`` was
        measured after it.
    train : Recording or sequence of Recording
    test : Recording or sequence of Recording, optional
        Recordings of other motion, on which errors are reported. Not allowed with a fit.
    method : {"ols", "wls", "robust"}
        Of the fits.
    processing : Processing, optional
        Filter options; the cut-off frequency is chosen from the data if not stated.
    options : DiagnosisOptions, optional
    seed : int
        Stated in the result; the method draws no random numbers.
    ask : callable, optional
        Called before each effect is added; False rejects it.
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
    chosen = options or DiagnosisOptions()
    recordings, tests = listed(train), [] if test is None else listed(test)
    if isinstance(model, Fit):
        if test is not None:
            raise IdentificationError(
                "a fit was given together with a test; with a fit, expected the recordings "
                "measured after it and no test"
            )
        kept, events = leave_out_events(model, recordings)
        changed = diagnose_changed(model, kept, options=chosen, report=report)
        return _with_events(replace(changed, seed=seed), events, recordings)
    report("identify", 0.0)
    first = identify(as_model(model), recordings, method=method, processing=processing)
    judged = with_brief_effects(first, recordings, method)
    kept, events = leave_out_events(judged, recordings)
    if any(event.kind != "standstill" for event in events):
        first = identify(as_model(model), kept, method=method, processing=first.processing)
    kept_tests, test_events = leave_out_events(judged, tests) if tests else ([], ())
    found = _Missing(first, kept, kept_tests, method, chosen, ask, report).diagnosis(seed)
    return _with_events(found, (*events, *test_events), [*recordings, *tests])


class _Missing:
    """The search for the effects that a model lacks.

    Parameters
    ----------
    first : Fit
        Of the model before any effect is added.
    train, tests : sequence of Recording
    method : str
    options : DiagnosisOptions
    ask : callable or None
    report : callable
    """

    def __init__(
        self,
        first: Fit,
        train: Sequence[Recording],
        tests: Sequence[Recording],
        method: Method,
        options: DiagnosisOptions,
        ask: Callable[[Proposal], bool] | None,
        report: Report,
    ) -> None:
        self.first, self.train, self.tests = first, train, tests
        self.method, self.options, self.ask, self.report = method, options, ask, report
        segments, _ = center_temperature(process(train, first.processing), first.temperature_mean)
        self.segments = segments
        self.known = tuple(FilteredColumns() for _ in segments)
        self.rejected: dict[str, str] = {}
        self.refused: set[str] = set()  # their fitted values are implausible
        self.differing: list[Difference] = []
        self.apart: list[list[Array]] = []  # columns of what differs between the recordings

    def diagnosis(self, seed: int) -> Diagnosis:
        """Return the diagnosis."""
        options, first = self.options, self.first
        rows = Rows.of(first, self.segments, known=self.known)
        fit, accepted, last = self._searched(rows)
        self.report("measure the effects", 0.85)
        tests = compared_segments(fit, self.tests) if self.tests else None
        final = FinalModel.of(fit, self.segments, tests)
        fit, accepted, final = self._pruned(fit, accepted, final, tests)
        before = compare(first, self.tests) if self.tests else None
        after = compare(fit, self.tests) if self.tests else None
        fitted = compare(fit, self.train)
        torque = np.array([np.sqrt(np.mean(t**2)) if len(t) else np.nan for t in rows.torque])
        steps = steps_of(final, accepted, torque, after)
        parts = unexplained_parts(fitted, after, self.rejected, options)
        shown = after or fitted
        verdict = "effect_found" if steps else "sufficient"
        if parts or self.differing:
            verdict = "unexplained"
        absorbed, weak = absorbed_and_weak(last)
        self.report("done", 1.0)
        return Diagnosis(
            mode="missing",
            verdict=verdict,
            joint_names=tuple(joint.name for joint in first.model.robot.joints),
            fit=fit,
            steps=steps,
            unexplained=parts,
            differing=tuple(self.differing),
            rejected=tuple(self.rejected.items()),
            noise_floor=shown.noise_floor,
            noise_source=shown.noise_source,
            baseline_effects=tuple(first.model.effects),
            baseline=_errors(first, before),
            expected=None,
            tried=sum(c.recording is None for c in last.columns.owners),
            absorbed=absorbed,
            weak=weak,
            warnings=unique_warnings(
                [
                    *first.model.unusable_effects,
                    *first.warnings,
                    *fit.warnings,
                    *_same_recording(first, self.tests),
                    *(before.warnings if before else ()),
                    *late_friction(last, options.worth),
                ]
            ),
            train=first.provenance.recordings,
            test=tuple(Source(r.name, r.source_hash) for r in self.tests),
            limits_reached=("most_steps",) if len(last.slots) >= options.most_steps else (),
            seed=seed,
        )

    def _searched(self, rows: Rows) -> tuple[Fit, list[Accepted], Round]:
        """Return the fit with all effects that are added, these effects, and the last round."""
        fit, accepted = self.first, list[Accepted]()
        for number in range(ROUNDS):
            self.report(_stage(accepted), 0.1 + 0.7 * number / ROUNDS)
            found = search(rows, self.options, refused=self.refused)
            new = self._accepted(found, {a.placement.label for a in accepted})
            apart = self._set_apart(found)
            if not new and not apart:
                break
            larger = self._fitted([a.placement for a in (*accepted, *new)])
            kept = [a for a in new if self._plausible(larger, a)]
            if len(kept) < len(new):
                larger = self._fitted([a.placement for a in (*accepted, *kept)])
            fit, accepted = larger, [*accepted, *kept]
            rows = Rows.of(fit, self.segments, known=self.known, before=rows)
            for columns in self.apart:
                rows = rows.with_apart(columns)
        return fit, accepted, found

    def _accepted(self, found: Round, have: set[str]) -> list[Accepted]:
        """Return the effects of a round that pass; the reasons against the others are kept."""
        new = list[Slot]()
        for slot in found.slots:
            if found.columns.candidate(slot.group).recording is not None:
                continue
            label = found.columns.candidate(slot.group).label
            reason = slot.reason(self.options)
            if reason is None and self.ask is not None and label not in have:
                joint = slot.joint
                sizes = found.spread[joint] * np.sqrt(
                    [
                        x[joint] / max(len(found.rows.runs[joint].all), 1)
                        for x in (slot.before, slot.after)
                    ]
                )
                if not self.ask(Proposal(label, joint, float(sizes[0]), float(sizes[1]))):
                    reason = "rejected by the user"
            if reason is None:
                new.append(slot)
                self.rejected.pop(label, None)
            else:
                self.rejected[label] = reason
        new = represented(found, new, self.options.rival_deviations)
        groups = [slot.group for slot in new]
        return [Accepted.of(found, slot, groups, self.options) for slot in new]

    def _set_apart(self, found: Round) -> bool:
        """Keep what differs between the recordings, and set its columns apart; whether any does."""
        before = len(self.apart)
        own = {p.label for p in self.first.model.placements}
        for slot in found.slots:
            candidate = found.columns.candidate(slot.group)
            if candidate.recording is None or slot.reason(self.options) is not None:
                continue
            names = [c.name for c in candidate.effect.coefficients]
            self.differing.append(
                Difference(
                    candidate.placement.label,
                    candidate.name,
                    candidate.joints,
                    found.rows.recording_names[candidate.recording],
                    dict(zip(names, map(float, slot.values), strict=True)),
                    {c.name: c.unit for c in candidate.effect.coefficients},
                    candidate.placement.label in own,
                )
            )
            self.apart.append(found.rows.columns.dense(slot.group))
        return len(self.apart) > before

    def _plausible(self, fit: Fit, found: Accepted) -> bool:
        """Whether the fitted values of an effect are plausible; the reason is kept."""
        values, shapes, _ = fitted_values(fit, found.placement)
        reason = reason_against(found.candidate, shapes, values, self.segments)
        if reason is not None:
            self.rejected[found.placement.label] = reason
            self.refused.add(found.placement.label)
        return reason is None

    def _fitted(self, added: Sequence[Placement]) -> Fit:
        """Return the fit of the first model with further effects, as `identify` fits it."""
        if not added:
            return self.first
        first = self.first.model
        model = Model.of_placements(first.robot, (*first.placements, *added))
        return identify_segments(
            compile(Model(model.robot, effects=model.effects, library=first.library)),
            self.segments,
            method=self.method,
            known=self.known,
            temperature_mean=self.first.temperature_mean,
            provenance=self.first.provenance,
        )

    def _pruned(
        self,
        fit: Fit,
        accepted: list[Accepted],
        final: FinalModel,
        tests: Sequence[Processed] | None,
    ) -> tuple[Fit, list[Accepted], FinalModel]:
        """Return the model without effects that are not worth their place in it.

        An effect of the library is judged without the smooth functions of its joint, which may
        contain it.
        """
        out = []
        for found in () if self.apart else accepted:  # the fit's errors contain what is set apart
            beside: list[Placement] = []
            if found.candidate.name != SMOOTH:
                beside = [
                    a.placement
                    for a in accepted
                    if a.candidate.name == SMOOTH and a.joint == found.joint
                ]
            reduced = final.errors(final.columns_of(beside))["cv"]
            without = final.errors(final.columns_of([*beside, found.placement]))["cv"]
            assert reduced is not None
            assert without is not None
            fall = 1.0 - reduced[found.joint] / without[found.joint]
            if fall < self.options.worth:
                out.append(found)
                self.rejected[found.placement.label] = (
                    "in the final model it lowers the cross-validated error by only "
                    f"{100 * max(fall, 0.0):.1f} %"
                )
        if not out:
            return fit, accepted, final
        kept = [a for a in accepted if a not in out]
        smaller = self._fitted([a.placement for a in kept])
        return smaller, kept, FinalModel.of(smaller, self.segments, tests)


def _stage(accepted: Sequence[Accepted]) -> str:
    labels = ", ".join(a.placement.label for a in accepted)
    return f"search beside {labels}" if labels else "search"


def _errors(fit: Fit, compared: Comparison | None) -> dict[str, Array | None]:
    """Return the errors of a fit by name; see `Step.errors`."""
    return {
        "rms_train": fit.rms_train,
        "rms_test": None if compared is None else compared.rms,
        "rms_test_moving": None if compared is None else compared.rms_moving,
        "rms_cv": fit.rms_cv,
    }


def _same_recording(fit: Fit, tests: Sequence[Recording]) -> list[SameRecordingWarning]:
    trained = {source.sha256 for source in fit.provenance.recordings}
    return [
        SameRecordingWarning(
            f"the test {r.name or 'recording'} is also a training recording, so that it cannot "
            "confirm the result; use a recording of other motion"
        )
        for r in tests
        if r.source_hash in trained
    ]


def _with_events(
    found: Diagnosis, events: tuple[Event, ...], recordings: Sequence[Recording]
) -> Diagnosis:
    """Return a diagnosis with the stretches left out; an arm at rest is not judged sufficient."""
    resting = any(len(e.joints) == found.fit.model.n for e in events if e.kind == "standstill")
    warnings = [w for w in found.warnings if not isinstance(w, DropoutWarning)]
    gaps = [w for r in recordings for w in check_time(r) if isinstance(w, DropoutWarning)]
    held = held_joints(found.fit, recordings)
    return replace(
        found,
        events=events,
        verdict="unexplained" if resting else found.verdict,
        warnings=unique_warnings([*warnings, *gaps, *held]),
    )
