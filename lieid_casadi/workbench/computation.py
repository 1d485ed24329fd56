"""What a worker process computes, with the public functions of the package; results are kept."""

from __future__ import annotations

import io
import tempfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeVar

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
    recording_titles,
    used_parts,
)
from lieid_casadi.workbench.session import FoundEffects, ModelStep, WorkbenchInputs

Progress = Callable[[str, float], None]
Kind = Literal["fit", "report", "c", "urdf", "mjcf"]
Prepared = tuple[PreparedRecordings | None, PreparedRecordings | None]  # training and test
Kept = TypeVar("Kept")
QUICK_ROWS = 60_000  # rows of all recordings above which the first result is that of a part
KEPT_RESULTS = 40  # of each kind


class Computation:
    """Inputs that are open, and what was computed for them."""

    def __init__(self, setup: WorkerSetup, inputs: WorkbenchInputs) -> None:
        self.inputs = inputs
        self._opened_fit = Fit.load(inputs.fit) if inputs.fit else None
        self._kept_fit = self._opened_fit if inputs.mode == "changed" else None
        self.robot = setup.robot(inputs) if self._kept_fit is None else self._kept_fit.model.robot
        read = setup.read(inputs, self._opened_fit or self.robot)
        titles = recording_titles(inputs)
        self.recordings = tuple(replace(r, name=t) for r, t in zip(read, titles, strict=True))
        self._rows = sum(len(r) for r in self.recordings)
        self._results: dict[str, dict[object, Any]] = {}
        fit = self._opened_fit
        self._processing: Processing | None = None if fit is None else fit.processing
        self._shapes: dict[str, float] = {}

    def opened(self) -> OpenedInputs:
        """Return facts about the robot and the recordings."""
        file = self.inputs.fit or self.inputs.robot
        return opened_inputs(self._first_model(), self.recordings, file=file)

    def evaluate(
        self,
        step: ModelStep,
        *,
        quick: bool,
        shapes: dict[str, float],
        report: Progress,
        processing: Processing | None = None,
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
        processing : Processing, optional
            Of the fits of another process, so that all have the same filter.
        """
        self._processing = self._processing or processing
        kept = self._kept("evaluation", step.key)
        if kept is not None:
            return kept  # type: ignore[no-any-return]
        begun, cpu = time.perf_counter(), time.process_time()
        self._shapes = shapes | self._shapes
        effort = self._effort(step, quick=quick)
        evaluation = replace(
            self._evaluation(self._fit(step, effort, report), step, effort),
            seconds=time.perf_counter() - begun,
            cpu_seconds=time.process_time() - cpu,
        )
        return self._keep("evaluation", step.key, evaluation, keep=evaluation.complete)

    def fit(self, step: ModelStep, report: Progress) -> Fit:
        """Return the exact fit of a step, with standard deviations."""
        return self._fit(step, Effort(), report)

    def find(
        self,
        step: ModelStep,
        *,
        report: Progress,
        found: Callable[[Proposal], None],
        processing: Processing | None = None,
    ) -> tuple[FoundEffects, bytes]:
        """Return the effects that the model of a step lacks, and the fit with all of them.

        With a kept fit, what has changed since. ``found`` is called with each effect as it is
        found. The fit is the content of a file, for `adopt`.
        """
        self._processing = self._processing or processing
        train, test = self.used(step)
        if self._kept_fit is not None:
            return found_effects(diagnose(self._kept_fit, test, progress=report), step.effects), b""

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
        return found_effects(diagnosis, step.effects), content_of(diagnosis.fit)

    def adopt(self, step: ModelStep, *, content: bytes) -> Evaluation:
        """Keep the fit that a diagnosis has made as that of a step; return its evaluation."""
        with tempfile.NamedTemporaryFile(suffix=".json") as file:  # its owner alone can read it
            file.write(content)
            file.flush()
            fit = self._keep("fit", (*step.key, False, False), Fit.load(file.name))
        return self._keep("evaluation", step.key, self._evaluation(fit, step, Effort()))

    def curves(
        self, step: ModelStep, *, recording: int, report: Progress
    ) -> dict[str, EffectCurve]:
        """Return the torque of each effect of a step along a recording, by the effect's label."""
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

    def save(self, step: ModelStep, *, kind: Kind, report: Progress) -> tuple[str, bytes]:
        """Return the name and the content of a file.

        Exports are zip files; for URDF and MJCF, the model is fitted with physically consistent
        inertias.
        """
        report("fit", 0.1)
        fit = self.fit(step, report)
        train, test = self.used(step)
        if kind == "fit":
            return "fit.json", content_of(fit)
        if kind == "report":
            report("simulation", 0.3)
            drift = window_drift(fit, test) if test else None
            report("report", 0.6)
            page = comparison_report(fit, compare(fit, test), drift) if test else fit_report(fit)
            return "report.html", page.encode(errors="replace")
        if kind in ("urdf", "mjcf") and fit.method != "feasible":
            report("fit with physically consistent inertias", 0.3)
            fit = identify(fit.model, train, method="feasible", processing=fit.processing)
        report("export", 0.8)
        with tempfile.TemporaryDirectory(prefix="lieid-") as folder:
            target = Path(folder) / kind
            export(fit, target, to=kind)
            return f"{fit.model.robot.name}_{kind}.zip", _zipped(target)

    def used(
        self, step: ModelStep, *, thinned: bool = False
    ) -> tuple[list[Recording], list[Recording]]:
        """Return training and test recordings without what is excluded."""
        used: dict[str, list[Recording]] = {"train": [], "test": []}
        share = QUICK_ROWS / self._rows if thinned else 1.0
        both = zip(self.inputs.recordings, self.recordings, strict=True)
        for k, (given, recording) in enumerate(both):
            role = "test" if self.inputs.mode == "changed" else given.role
            used[role] += used_parts(recording, k, step.excluded, share=share)
        if self.inputs.mode == "missing" and not used["train"]:
            raise UsageError("no training recording is left; undo the exclusion or open another")
        return used["train"], used["test"]

    def _first_model(self) -> Model:
        if self._opened_fit is not None and not self.inputs.effects:
            return self._opened_fit.model
        both = zip(self.inputs.recordings, self.recordings, strict=True)
        train = [recording for given, recording in both if given.role == "train"]
        return Model(self.robot, self.inputs.effects or default_effects(self.robot, train).names)

    def _effort(self, step: ModelStep, *, quick: bool) -> Effort:
        """Return what a fit of a step leaves out."""
        if not quick or self._kept("fit", (*step.key, False, False)) is not None:
            return Effort()
        thinned = self._rows > QUICK_ROWS
        return Effort(
            held=bool(Model(self.robot, step.effects).shapes) and self.inputs.mode == "missing",
            thinned=thinned,
            brief=self._kept("noise", (step.excluded, thinned)) is not None,
        )

    def _fit(self, step: ModelStep, effort: Effort, report: Progress) -> Fit:
        """Return the fit of a step; the first of its recordings also chooses the filter."""
        if self._kept_fit is not None:
            return self._kept_fit
        key = (*step.key, effort.held, effort.thinned)
        kept = self._kept("fit", key)
        if kept is not None:
            return kept  # type: ignore[no-any-return]
        model, start = Model(self.robot, step.effects), None
        if effort.held:
            values = [
                self._shapes.get(s.label, s.initial) if s.fitted else np.nan for s in model.shapes
            ]
            start = ShapeStart(np.array(values), held=True)
        first = self._kept("first fit", (step.excluded, effort.thinned))
        if first is None:
            train, _ = self.used(step, thinned=effort.thinned)
            fit = identify(model, train, processing=self._processing, start=start, progress=report)
            self._keep("first fit", (step.excluded, effort.thinned), fit)
            self._processing = fit.processing
        else:
            prepared, _ = self._prepared(step, first, thinned=effort.thinned)
            assert prepared is not None
            fit = prepared.fitted(
                model, first, start=start, uncertainty=not effort.brief, report=report
            )
        if not effort.held:
            found = zip(model.shapes, fit.shapes, strict=True)
            self._shapes.update({s.label: float(v) for s, v in found})
        return self._keep("fit", key, fit, keep=first is None or not effort.brief)

    def _prepared(self, step: ModelStep, fit: Fit, *, thinned: bool) -> Prepared:
        """Return training and test recordings of a step, processed for its fits."""
        key = (step.excluded, thinned)
        kept = self._kept("prepared", key)
        if kept is not None:
            return kept  # type: ignore[no-any-return]
        train, test = self.used(step, thinned=thinned)
        made = (
            PreparedRecordings.of(fit, train, average=True) if train else None,
            PreparedRecordings.of(fit, test, average=False) if test else None,
        )
        return self._keep("prepared", key, made, most=KEPT_RESULTS // 6)

    def _evaluation(self, fit: Fit, step: ModelStep, effort: Effort) -> Evaluation:
        """Compare a fit with all recordings of a step."""
        train, test = self._prepared(step, fit, thinned=effort.thinned)
        key = (step.excluded, effort.thinned)
        noise = self._kept("noise", key) if effort.brief else None
        made = evaluate_fit(fit, train, test, step.changes, effort=effort, noise=noise)
        if noise is None and made.shown is not None:
            self._keep("noise", key, NoiseFloor(made.shown.noise_floor, made.shown.noise_source))
        return made

    def _kept(self, kind: str, key: object) -> Any:
        """Return a result that was kept, None without."""
        return self._results.get(kind, {}).get(key)

    def _keep(
        self, kind: str, key: object, value: Kept, *, keep: bool = True, most: int = KEPT_RESULTS
    ) -> Kept:
        """Keep and return a result; the oldest of its kind are dropped."""
        if keep:
            results = self._results.setdefault(kind, {})
            results[key] = value
            while len(results) > most:
                del results[next(iter(results))]
        return value


def _zipped(folder: Path) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                archive.write(file, file.relative_to(folder.parent))
    return content.getvalue()
