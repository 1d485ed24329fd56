"""What a worker process computes, with the public functions of the package; results are kept."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePath
from typing import Any, Literal, TypeVar

import numpy as np

from lieid_casadi import premises
from lieid_casadi.arrays import Array
from lieid_casadi.comparison import Comparison, compare
from lieid_casadi.comparison.compare import compare_segments, compared_segments
from lieid_casadi.comparison.comparison import verdict_sentences
from lieid_casadi.compiled import compile
from lieid_casadi.diagnosis import diagnose
from lieid_casadi.errors import LieidWarning, ModelError, RecordingError, UsageError
from lieid_casadi.exporters.export import export
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.fit import content_of
from lieid_casadi.identification.identify import default_effects, identify_segments
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import check_recordings
from lieid_casadi.identification.regression.design_matrix import FilteredColumns
from lieid_casadi.json_numbers import numbers_or_none
from lieid_casadi.model import Model
from lieid_casadi.premises import PremiseCheck
from lieid_casadi.recording import Processed, Processing, Recording, check, process
from lieid_casadi.report import comparison_report, fit_report
from lieid_casadi.workbench import evaluation
from lieid_casadi.workbench.arm import ArmMotion, arm_motion
from lieid_casadi.workbench.session import (
    ExcludedRange,
    FoundEffects,
    ModelStep,
    Progress,
    Role,
    StepErrors,
    WorkbenchInputs,
    WorkerSetup,
    kept_parts,
)

Kind = Literal["fit", "report", "c", "urdf", "mjcf"]
Kept = TypeVar("Kept")
QUICK_ROWS = 60_000  # of all recordings, above which a part of them chooses the filter
PART_ROWS = 15_000  # of the grid, in each of two parts of which models with shapes are first fitted
SHAPE_ROWS = 5_000  # of each of these parts, which shape parameters are found on
KEPT_RESULTS, KEPT_PREPARED = 40, 8  # of each kind; of processed recordings, which are large
MOST_STRETCHES = 8  # of each recording in such a part
GRID = ("t", "q", "dq", "ddq", "tau", "temperature", "moving", "command")  # arrays of a segment
LEAST_DURATION = 5.0  # s, of a stretch; the filter needs a second at each of its ends
REMEDY = "“Find what is missing” searches the library of effects"


class Computation:
    """Inputs that are open, and what was computed for them."""

    def __init__(self, setup: WorkerSetup, inputs: WorkbenchInputs) -> None:
        self.inputs = inputs
        self._opened_fit = fit = Fit.load(inputs.fit) if inputs.fit else None
        self.robot = setup.robot(inputs)
        read = setup.read(inputs, fit or self.robot)
        titles = recording_titles(inputs)
        self.recordings = tuple(replace(r, name=t) for r, t in zip(read, titles, strict=True))
        self._rows = sum(len(r) for r in self.recordings)
        self._results: dict[tuple[object, ...], Any] = {}
        self._processing: Processing | None = None if fit is None else fit.processing

    def opened(self) -> evaluation.OpenedInputs:
        """Return facts about the robot and the recordings."""
        file = self.inputs.fit or self.inputs.robot
        return evaluation.opened_inputs(self._first_model(), self.recordings, file=file)

    def premises(self, *, report: Progress) -> PremiseCheck | str:
        """Return whether robot and recordings belong together, or why this cannot be tested."""
        if any(r.tau is None or r.command is not None for r in self.recordings):
            return "the torques of a drive law are assumptions themselves"
        use = {"train": [], "test": []}  # type: dict[str, list[Recording]]
        for given, recording in zip(self.inputs.recordings, self.recordings, strict=True):
            use[given.role].append(recording)
        try:
            return premises.check(self.robot, use["train"], test=use["test"], progress=report)
        except (ModelError, RecordingError) as error:
            return " ".join(str(error).split())

    def evaluate(
        self,
        step: ModelStep,
        *,
        quick: bool,
        report: Progress,
        processing: Processing | None = None,
    ) -> evaluation.Evaluation:
        """Return the fit of a step, compared with all recordings.

        A quick one leaves out what takes longer than the fit: standard deviations, and the noise
        floor, which is that of the model before; a first model has both unless the recordings are
        very long. It is exact but for models with shape parameters of long recordings: these are
        found on a small part, and of the fits of two other parts with them, each joint has the
        larger error of all unseen rows. Errors of
        training of very long recordings are unknown.
        ``processing`` is that of the fits of another process, so that all have the same filter.
        """
        self._processing = self._processing or processing
        share = min(1.0, QUICK_ROWS / self._rows)
        brief = share < 1.0 or ("noise", step.excluded) in self._results
        if not quick or not brief or ("fit", step.key) in self._results:
            return self._evaluation(step, self.fit(step, report))
        fits = self._quick_fits(step, share, report)
        exact = len(fits) == 1
        made = self._evaluation(step, fits[0], exact=exact, complete=False, share=share)
        others = (self._unseen_error(step, fit) for fit in fits[1:])
        every = np.array([made.errors.shown, *others], dtype=float)  # of each joint the largest
        shown = tuple(numbers_or_none(every.max(axis=0)))
        return replace(made, errors=replace(made.errors, shown=shown))

    def fit(self, step: ModelStep, report: Progress) -> Fit:
        """Return the exact fit of a step, with standard deviations."""
        kept: Fit | None = self._results.get(("fit", step.key))
        if kept is None:
            model, first = Model(self.robot, step.effects), self._first(step, 1.0, report)
            kept = first
            if first.model.effects != model.effects:
                train = self._prepared("train", step, first)
                kept = train.fitted(model, first, report=report)
        return self._keep(("fit", step.key), kept)

    def find(
        self, step: ModelStep, *, report: Progress, processing: Processing | None = None
    ) -> tuple[FoundEffects, bytes]:
        """Return the effects that the model of a step lacks, and the fit with all of them."""
        self._processing = self._processing or processing
        train, test = self.used(step)
        diagnosis = diagnose(
            Model(self.robot, step.effects),
            train,
            test or None,
            processing=self._processing,
            progress=report,
        )
        return evaluation.found_effects(diagnosis, step.effects), content_of(diagnosis.fit)

    def adopt(self, step: ModelStep, *, content: bytes) -> evaluation.Evaluation:
        """Keep the fit that a diagnosis has made as that of a step; return its evaluation."""
        with tempfile.NamedTemporaryFile(suffix=".json") as file:  # its owner alone can read it
            file.write(content)
            file.flush()
            fit = self._keep(("fit", step.key), Fit.load(file.name))
        return self._evaluation(step, fit)

    def curves(
        self, step: ModelStep, *, recording: int, report: Progress
    ) -> dict[str, evaluation.EffectCurve]:
        """Return the torque of each effect of a step along a recording, by the effect's label."""
        return evaluation.effect_curves(self.fit(step, report), self.recordings[recording])

    def motion(self, recording: int) -> ArmMotion:
        """Return the poses of the arm along a recording."""
        shown = self.recordings[recording]
        return arm_motion(self.robot, shown.t, shown.q)

    def save(self, step: ModelStep, *, kind: Kind, report: Progress) -> tuple[str, bytes]:
        """Return the name and the content of a file."""
        report("fit", 0.1)
        fit = self.fit(step, report)
        train, test = self.used(step)
        if kind == "fit":
            return "fit.json", content_of(fit)
        if kind == "report":
            report("report", 0.6)
            page = comparison_report(fit, compare(fit, test)) if test else fit_report(fit)
            return "report.html", page.encode(errors="replace")
        if kind in ("urdf", "mjcf") and fit.method != "feasible":

            def of_fit(stage: str, fraction: float) -> None:
                report("fit with physically consistent inertias", 0.1 + 0.7 * fraction)

            fit = identify(
                fit.model, train, method="feasible", processing=fit.processing, progress=of_fit
            )
        report("export", 0.8)
        with tempfile.TemporaryDirectory(prefix="lieid-") as folder:
            export(fit, Path(folder, kind), to=kind)
            archive = shutil.make_archive(f"{folder}/files", "zip", folder, kind)
            return f"{fit.model.robot.name}_{kind}.zip", Path(archive).read_bytes()

    def used(self, step: ModelStep, share: float = 1.0) -> tuple[list[Recording], list[Recording]]:
        """Return training and test recordings without what is excluded, or a share of them."""
        used: dict[str, list[Recording]] = {"train": [], "test": []}
        both = zip(self.inputs.recordings, self.recordings, strict=True)
        for k, (given, recording) in enumerate(both):
            used[given.role] += used_parts(recording, k, step.excluded, share)
        if not used["train"]:
            raise UsageError("no training recording is left; undo the exclusion or open another")
        return used["train"], used["test"]

    def _first_model(self) -> Model:
        if self._opened_fit is not None and not self.inputs.effects:
            return self._opened_fit.model
        both = zip(self.inputs.recordings, self.recordings, strict=True)
        train = [recording for given, recording in both if given.role == "train"]
        return Model(self.robot, self.inputs.effects or default_effects(self.robot, train).names)

    def _first(self, step: ModelStep, share: float, report: Progress) -> Fit:
        """Return the first fit to a share of these recordings, which also chooses the filter."""
        key = ("first", step.excluded, share)
        if key not in self._results:
            model, (train, _) = Model(self.robot, step.effects), self.used(step, share)
            fit = identify(model, train, processing=self._processing, progress=report)
            self._processing = fit.processing
            self._keep(key, fit)
        return self._results[key]  # type: ignore[no-any-return]

    def _quick_fits(self, step: ModelStep, share: float, report: Progress) -> list[Fit]:
        """Return the fit without standard deviations, or those of two parts if that takes long."""
        model, first = Model(self.robot, step.effects), self._first(step, share, report)
        tested = any(given.role == "test" for given in self.inputs.recordings)
        quick: dict[str, Any] = {"uncertainty": False, "held_out": not tested, "report": report}
        train = self._prepared("train", step, first)
        rows = sum(len(segment) for segment in train.segments)
        fitted = np.array([shape.fitted for shape in model.shapes], dtype=bool)
        if rows <= 4 * SHAPE_ROWS or not fitted.any():
            return [train.fitted(model, first, **quick)]
        few = self._prepared("train", step, first, SHAPE_ROWS / rows)
        held = np.where(fitted, few.fitted(model, first, **quick).shapes, np.nan)
        size = min(0.5, PART_ROWS / rows)
        parts = (self._prepared("train", step, first, size, delay) for delay in (0.0, 0.5))
        return [part.fitted(model, first, held_shapes=held, **quick) for part in parts]

    def _prepared(
        self, role: Role, step: ModelStep, fit: Fit, share: float = 1.0, delay: float = 0.0
    ) -> PreparedRecordings:
        """Return the recordings of a role, processed for fits of a step, or a share of them."""
        key = ("prepared", role, step.excluded, share, delay)
        if key not in self._results:
            if share < 1.0:
                made = self._prepared(role, step, fit).part(share, delay)
            else:
                given = self.used(step)[role == "test"]
                made = PreparedRecordings.of(fit, given, average=role == "train")
            self._keep(key, made)
        return self._results[key]  # type: ignore[no-any-return]

    def _evaluation(
        self,
        step: ModelStep,
        fit: Fit,
        *,
        exact: bool = True,
        complete: bool = True,
        share: float = 1.0,
    ) -> evaluation.Evaluation:
        """Compare a fit with the recordings of a step.

        Where there is a test, a ``share`` of the training is compared. The noise floor of an
        incomplete evaluation is that of the model before.
        """
        test, key = self.used(step)[1], ("noise", step.excluded)
        share = share if test else 1.0
        prepared = self._prepared("train", step, fit, share)
        shown = on_train = prepared.compared(fit, with_noise=complete and not test)
        on_test, error = None, fit.rms_cv
        if test:
            prepared = self._prepared("test", step, fit)
            shown = on_test = prepared.compared(fit, with_noise=complete)
            error = on_test.rms_moving
        if complete:
            self._keep(key, shown.noise_floor)
        elif key in self._results:  # a noise floor never exceeds the error; NaN: a joint at rest
            shown = replace(shown, noise_floor=np.minimum(self._results[key], shown.rms_moving))
        trained = on_train.rms_moving if share == 1.0 else np.full(fit.model.n, np.nan)
        columns = (trained, error, shown.noise_floor, _spread(shown))
        return evaluation.Evaluation(
            exact=exact,
            complete=complete,
            errors=StepErrors(*(tuple(numbers_or_none(values)) for values in columns)),
            train=on_train,
            test=on_test,
            sentence="\n".join(verdict_sentences(shown, REMEDY)),
            effects=evaluation.effect_rows(fit),
            cutoff=fit.processing.cutoff or shown.cutoff,
            processing=fit.processing,
        )

    def _unseen_error(self, step: ModelStep, fit: Fit) -> Array:
        """Return the RMS error in motion (n,) of a fit on the test or held-out rows, N·m."""
        if not self.used(step)[1]:
            return fit.rms_cv
        return self._prepared("test", step, fit).compared(fit, with_noise=False).rms_moving

    def _keep(self, key: tuple[object, ...], value: Kept) -> Kept:
        """Keep and return a result; the oldest of its kind is dropped."""
        self._results[key] = value
        same = [other for other in self._results if other[0] == key[0]]
        if len(same) > (KEPT_PREPARED if key[0] == "prepared" else KEPT_RESULTS):
            del self._results[same[0]]
        return value


def _spread(comparison: Comparison) -> Array:
    """Return the standard deviation of the measured torque in motion (n,), NaN at rest, N·m."""
    measured = np.concatenate([s.measured for s in comparison.series])
    moving = np.concatenate([s.moving for s in comparison.series])
    values = [torque[use] for torque, use in zip(measured.T, moving.T, strict=True)]
    return np.array([part.std() if part.size else np.nan for part in values])


def recording_titles(inputs: WorkbenchInputs) -> list[str]:
    """Return a short, unique title of each recording: its file name, its path if two are equal."""
    names = [PurePath(r.path).name for r in inputs.recordings]
    count, paths = Counter(names), Counter(r.path for r in inputs.recordings)
    titles = []
    for k, (name, each) in enumerate(zip(names, inputs.recordings, strict=True)):
        if count[name] > 1:
            name = each.path if paths[each.path] == 1 else f"{each.path} ({k + 1})"
        titles.append(name)
    return titles


def used_parts(
    recording: Recording, number: int, excluded: Sequence[ExcludedRange], share: float = 1.0
) -> list[Recording]:
    """Return the parts of recording ``number`` that are not excluded, or a share of each."""
    parts = []
    for start, end in kept_parts(excluded, number):
        with contextlib.suppress(RecordingError):  # no rows between two excluded stretches
            whole = start is None and end is None
            parts.append(recording if whole else recording.cut(start, end))
    if share >= 1.0:
        return parts
    return [
        part.rows(*ends) for part in parts for ends in stretches(len(part), part.duration, share)
    ]


def stretches(
    rows: int, duration: float, share: float, delay: float = 0.0
) -> list[tuple[int, int]]:
    """Return first rows and ends of evenly spread stretches that are a share of all rows.

    Each begins after a part ``delay`` of its turn; ``duration`` is that of all rows, s.
    """
    count = int(np.clip(share * duration / LEAST_DURATION, 1, MOST_STRETCHES))
    turn = rows / count
    starts = (np.arange(count) + delay) * turn
    return [(int(start), int(start + share * turn)) for start in starts]


@dataclass(frozen=True, eq=False)
class PreparedRecordings:
    """Recordings with their segments through the filter of a fit, and warnings of the checks."""

    recordings: tuple[Recording, ...]
    segments: tuple[Processed, ...]
    warnings: tuple[LieidWarning, ...]

    @classmethod
    def of(cls, fit: Fit, recordings: Sequence[Recording], *, average: bool) -> PreparedRecordings:
        """Check and process recordings as a fit does (``average`` periods) or a comparison."""
        check_recordings(fit.model, recordings)
        if average:
            averaged = process(recordings, fit.processing)
            segments, _ = center_temperature(averaged, fit.temperature_mean)
        else:
            segments = compared_segments(fit, recordings)
        found = [w for r in recordings for w in check(r, fit.model.robot)]
        found += [w for segment in segments for w in segment.warnings]
        return cls(tuple(recordings), segments, tuple(found))

    def part(self, share: float, delay: float) -> PreparedRecordings:
        """Return evenly spread stretches of the segments; see `stretches`."""
        found = []
        for s in self.segments:
            arrays = {k: v for k, v in vars(s).items() if k in GRID and v is not None}
            for first, end in stretches(len(s), len(s) / s.rate, share, delay):
                found.append(replace(s, **{k: v[first:end] for k, v in arrays.items()}))
        return replace(self, segments=tuple(found))

    @cached_property
    def _known(self) -> tuple[FilteredColumns, ...]:
        """Filtered columns of each segment, which all fitted models share."""
        return tuple(FilteredColumns() for _ in self.segments)

    def fitted(
        self,
        model: Model,
        first: Fit,
        *,
        report: Progress,
        held_shapes: Array | None = None,
        uncertainty: bool = True,
        held_out: bool = True,
    ) -> Fit:
        """Return the fit of another model with the method and filter of the first one."""
        check_recordings(model, self.recordings)
        found = identify_segments(
            compile(model),
            self.segments,
            method="wls",
            held_shapes=held_shapes,
            held_out=held_out,
            temperature_mean=first.temperature_mean,
            provenance=first.provenance,
            known=self._known,
            warnings=self.warnings,
            report=report,
        )
        return found.complete() if uncertainty else found.fit

    def compared(self, fit: Fit, *, with_noise: bool) -> Comparison:
        """Return the comparison of a fit with these recordings."""
        check_recordings(fit.model, self.recordings)
        return compare_segments(
            fit, self.recordings, self.segments, warnings=self.warnings, with_noise=with_noise
        )
