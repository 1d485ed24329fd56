"""What a worker process computes, with the public functions of the package; results are kept."""

from __future__ import annotations

import io
import tempfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from lieid_casadi.comparison import compare
from lieid_casadi.diagnosis import Proposal, diagnose
from lieid_casadi.errors import UsageError
from lieid_casadi.exporters.export import export
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.default_effects import default_effects
from lieid_casadi.identification.fit_file import content_of
from lieid_casadi.identification.regression.fixed_point import ShapeStart
from lieid_casadi.json_numbers import numbers_or_none
from lieid_casadi.model import Model
from lieid_casadi.recording import Processing, Recording
from lieid_casadi.report import comparison_report, fit_report
from lieid_casadi.simulation import window_drift
from lieid_casadi.workbench.arm import ArmMotion, arm_motion
from lieid_casadi.workbench.evaluation import (
    EffectCurve,
    Effort,
    Evaluation,
    OpenedInputs,
    SimulationError,
    effect_curves,
    evaluate_fit,
    found_effects,
    opened_inputs,
)
from lieid_casadi.workbench.recordings import (
    NoiseFloor,
    PreparedRecordings,
    WorkerSetup,
    evenly_spread,
    recording_titles,
    without_excluded,
)
from lieid_casadi.workbench.session import FoundEffects, ModelStep, WorkbenchInputs, kept_parts

Progress = Callable[[str, float], None]
QUICK_ROWS = 60_000  # rows of all recordings above which the first result is that of a part
KEPT_RESULTS = 40
KEPT_RECORDINGS = 6
Kept = TypeVar("Kept")
Prepared = tuple[PreparedRecordings | None, PreparedRecordings | None]  # training and test


class Computation:
    """Inputs that are open, and what was computed for them."""

    def __init__(self, setup: WorkerSetup, inputs: WorkbenchInputs) -> None:
        self.inputs = inputs
        self._opened_fit = Fit.load(inputs.fit) if inputs.fit else None
        kept = self._opened_fit if inputs.mode == "changed" else None
        self.robot = setup.robot(inputs) if kept is None else kept.model.robot
        read = setup.read(inputs, self._opened_fit or self.robot)
        titles = recording_titles(inputs)
        self.recordings = tuple(replace(r, name=t) for r, t in zip(read, titles, strict=True))
        self._fits: dict[object, Fit] = {}
        self._first_fits: dict[object, Fit] = {}
        self._prepared_recordings: dict[object, Prepared] = {}
        self._evaluations: dict[object, Evaluation] = {}
        self._noise_floors: dict[object, NoiseFloor] = {}
        self._processing: Processing | None = None
        if self._opened_fit is not None:
            self._processing = self._opened_fit.processing
        self._shapes: dict[str, float] = {}

    def opened(self) -> OpenedInputs:
        """Return facts about the robot and the recordings."""
        kept = self._opened_fit if self.inputs.mode == "changed" else None
        file = self.inputs.fit or self.inputs.robot
        return opened_inputs(self._first_model(), self.recordings, kept, file=file)

    def evaluate(
        self, step: ModelStep, *, quick: bool, shapes: dict[str, float], report: Progress
    ) -> Evaluation:
        """Return the fit of a step, compared with all recordings.

        Parameters
        ----------
        quick : bool
            Hold shape parameters, use parts of long recordings, and leave out what takes longer
            than the fit: standard deviations, and the noise floor, which is that of the model
            before. A first model has both.
        shapes : dict
            Shape parameters by label, at which a quick fit holds those that no fit has found.
        report : callable
            Called with the name of a stage and the fraction done.
        """
        key = step.key
        if key in self._evaluations:
            return self._evaluations[key]
        begun, cpu = time.perf_counter(), time.process_time()
        self._shapes = shapes | self._shapes
        effort = self._effort(step, quick=quick)
        fit = self._fit(step, effort, report)
        evaluation = replace(
            self._evaluation(fit, step, effort),
            seconds=time.perf_counter() - begun,
            cpu_seconds=time.process_time() - cpu,
        )
        if evaluation.complete:
            _keep(self._evaluations, key, evaluation)
        return evaluation

    def fit(self, step: ModelStep, report: Progress) -> Fit:
        """Return the exact fit of a step, with standard deviations."""
        return self._fit(step, Effort(), report)

    def find(
        self, step: ModelStep, *, report: Progress, found: Callable[[Proposal], None]
    ) -> FoundEffects:
        """Return the effects that the model of a step lacks, or what has changed since the fit.

        Parameters
        ----------
        report : callable
            Called with the name of a stage and the fraction done.
        found : callable
            Called with each effect as it is found.
        """
        train, test = self.used(step)
        if self.inputs.mode == "changed":
            assert self._opened_fit is not None
            return found_effects(diagnose(self._opened_fit, test, progress=report), step)

        def ask(proposal: Proposal) -> bool:
            found(proposal)
            return True

        diagnosis = diagnose(
            Model(self.robot, step.effects),
            train,
            test or None,
            processing=self._processing,
            ask=ask,
            progress=report,
        )
        return found_effects(diagnosis, step)

    def curves(
        self, step: ModelStep, *, recording: int, report: Progress
    ) -> dict[str, EffectCurve]:
        """Return the torque of each effect of a step along a recording, by the effect's label.

        Parameters
        ----------
        report : callable
            Called with the name of a stage and the fraction done.
        """
        return effect_curves(self.fit(step, report), self.recordings[recording])

    def simulate(self, step: ModelStep, *, report: Progress) -> SimulationError:
        """Return how far a simulation with a step's fit leaves the measured motion.

        That of the test, of the training without a test.
        """
        if step.changes:
            reason = "changes since the fit are not part of a simulation"
            return SimulationError(0.0, (None,) * self.robot.n, reason)
        fit = self.fit(step, report)
        train, test = self.used(step)
        drift = window_drift(fit, test or train)
        return SimulationError(drift.window, tuple(numbers_or_none(drift.drift.rms)), drift.reason)

    def motion(self, recording: int) -> ArmMotion:
        """Return the poses of the arm along a recording."""
        return arm_motion(self.robot, self.recordings[recording])

    def _first_model(self) -> Model:
        if self._opened_fit is not None and not self.inputs.effects:
            return self._opened_fit.model
        train = [
            recording
            for given, recording in zip(self.inputs.recordings, self.recordings, strict=True)
            if given.role == "train"
        ]
        return Model(self.robot, self.inputs.effects or default_effects(self.robot, train).names)

    def used(
        self, step: ModelStep, *, thinned: bool = False
    ) -> tuple[list[Recording], list[Recording]]:
        """Return training and test recordings without what is excluded."""
        used: dict[str, list[Recording]] = {"train": [], "test": []}
        rows = sum(len(r) for r in self.recordings)
        for k, (each, recording) in enumerate(
            zip(self.inputs.recordings, self.recordings, strict=True)
        ):
            parts = without_excluded(recording, kept_parts(step.excluded, k))
            if thinned:
                parts = [p for part in parts for p in evenly_spread(part, QUICK_ROWS / rows)]
            role = "test" if self.inputs.mode == "changed" else each.role
            used[role] += parts
        if self.inputs.mode == "missing" and not used["train"]:
            raise UsageError("no training recording is left; undo the exclusion or open another")
        return used["train"], used["test"]

    def _effort(self, step: ModelStep, *, quick: bool) -> Effort:
        """Return what a fit of a step leaves out."""
        if not quick:
            return Effort()
        thinned = sum(len(r) for r in self.recordings) > QUICK_ROWS
        shapes = Model(self.robot, step.effects).shapes
        return Effort(
            held=bool(shapes) and self.inputs.mode == "missing",
            thinned=thinned,
            brief=(step.excluded, thinned) in self._noise_floors,
        )

    def _fit(self, step: ModelStep, effort: Effort, report: Progress) -> Fit:
        """Return the fit of a step; the first of its recordings also chooses the filter."""
        if self.inputs.mode == "changed":
            assert self._opened_fit is not None
            return self._opened_fit
        key = (*step.key, effort.held, effort.thinned)
        if key in self._fits:
            return self._fits[key]
        model, start = Model(self.robot, step.effects), None
        if effort.held:
            values = [
                self._shapes.get(s.label, s.initial) if s.fitted else np.nan for s in model.shapes
            ]
            start = ShapeStart(np.array(values), held=True)
        first = self._first_fits.get((step.excluded, effort.thinned))
        if first is None:
            train, _ = self.used(step, thinned=effort.thinned)
            fit = identify(model, train, processing=self._processing, start=start, progress=report)
            self._first_fits[step.excluded, effort.thinned] = fit
            self._processing = fit.processing
        else:
            train_prepared, _ = self._prepared(step, first, thinned=effort.thinned)
            assert train_prepared is not None
            fit = train_prepared.fitted(
                model, first, start=start, uncertainty=not effort.brief, report=report
            )
        if not effort.held:
            self._shapes.update(
                {s.label: float(v) for s, v in zip(model.shapes, fit.shapes, strict=True)}
            )
        if first is None or not effort.brief:
            _keep(self._fits, key, fit)
        return fit

    def _prepared(self, step: ModelStep, fit: Fit, *, thinned: bool) -> Prepared:
        """Return training and test recordings of a step, processed for its fits."""
        key = (step.excluded, thinned)
        if key not in self._prepared_recordings:
            train, test = self.used(step, thinned=thinned)
            made = (
                PreparedRecordings.of(fit, train, average=True) if train else None,
                PreparedRecordings.of(fit, test, average=False) if test else None,
            )
            _keep(self._prepared_recordings, key, made, most=KEPT_RECORDINGS)
        return self._prepared_recordings[key]

    def _evaluation(self, fit: Fit, step: ModelStep, effort: Effort) -> Evaluation:
        """Compare a fit with all recordings of a step."""
        train, test = self._prepared(step, fit, thinned=effort.thinned)
        key = (step.excluded, effort.thinned)
        noise = self._noise_floors[key] if effort.brief else None
        made = evaluate_fit(fit, train, test, step.changes, effort=effort, noise=noise)
        shown = made.test or made.train
        if noise is None and shown is not None:
            floor = NoiseFloor(shown.noise_floor, shown.noise_source)
            _keep(self._noise_floors, key, floor, most=KEPT_RECORDINGS)
        return made


def _keep(cache: dict[object, Kept], key: object, value: Kept, *, most: int = KEPT_RESULTS) -> None:
    """Add an entry to a cache, and drop the oldest beyond its size."""
    cache[key] = value
    while len(cache) > most:
        del cache[next(iter(cache))]


Kind = Literal["fit", "report", "c", "urdf", "mjcf"]


def saved_file(
    state: Computation, step: ModelStep, *, kind: Kind, report: Callable[[str, float], None]
) -> tuple[str, bytes]:
    """Return the name and the content of a file.

    Parameters
    ----------
    kind : {"fit", "report", "c", "urdf", "mjcf"}
        Exports are zip files; for URDF and MJCF, the model is fitted with physically consistent
        inertias.
    report : callable
        Called with the name of a stage and the fraction done.
    """
    fit = state.fit(step, report)
    train, test = state.used(step)
    if kind == "fit":
        return "fit.json", content_of(fit)
    if kind == "report":
        drift = window_drift(fit, test) if test else None
        page = comparison_report(fit, compare(fit, test), drift) if test else fit_report(fit)
        return "report.html", page.encode(errors="replace")
    if kind in ("urdf", "mjcf") and fit.method != "feasible":
        fit = identify(fit.model, train, method="feasible", processing=fit.processing)
    with tempfile.TemporaryDirectory(prefix="lieid-") as folder:
        target = Path(folder) / kind
        export(fit, target, to=kind)
        return f"{fit.model.robot.name}_{kind}.zip", _zipped(target)


def _zipped(folder: Path) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                archive.write(file, file.relative_to(folder.parent))
    return content.getvalue()
