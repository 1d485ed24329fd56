"""What a worker process computes, with the public functions of the package; results are kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from lieid_casadi.comparison.verdict import verdict
from lieid_casadi.diagnosis import Proposal, diagnose
from lieid_casadi.errors import UsageError
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.default_effects import default_effects
from lieid_casadi.identification.regression.fixed_point import ShapeStart
from lieid_casadi.json_numbers import numbers_or_none
from lieid_casadi.model import Model
from lieid_casadi.recording import Processing, Recording
from lieid_casadi.simulation import window_drift
from lieid_casadi.workbench.computing.arm_motion import arm_motion
from lieid_casadi.workbench.computing.effect_curves import effect_curves
from lieid_casadi.workbench.computing.found_effects import found_effects
from lieid_casadi.workbench.computing.model_effects import change_rows, effect_rows
from lieid_casadi.workbench.computing.opened_inputs import opened_inputs
from lieid_casadi.workbench.computing.prepared_recordings import PreparedRecordings
from lieid_casadi.workbench.computing.recording_parts import (
    evenly_spread,
    recording_titles,
    without_excluded,
)
from lieid_casadi.workbench.computing.results import (
    ArmMotion,
    EffectCurve,
    Evaluation,
    OpenedInputs,
    SimulationError,
    WorkerSetup,
)
from lieid_casadi.workbench.state.inputs import WorkbenchInputs, kept_parts
from lieid_casadi.workbench.state.proposals import FoundEffects
from lieid_casadi.workbench.state.session import ModelStep, StepErrors

Progress = Callable[[str, float], None]
QUICK_ROWS = 60_000  # rows of all recordings above which the first result is that of a part
KEPT_RESULTS = 40
KEPT_RECORDINGS = 6
Kept = TypeVar("Kept")
Prepared = tuple[PreparedRecordings | None, PreparedRecordings | None]  # training and test


class Computation:
    """Inputs that are open, and what was computed for them.

    Parameters
    ----------
    setup : WorkerSetup
    inputs : WorkbenchInputs
    """

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
        step : ModelStep
        quick : bool
            Hold shape parameters and use parts of long recordings, where this saves time.
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
        model = Model(self.robot, step.effects)
        thinned = quick and sum(len(r) for r in self.recordings) > QUICK_ROWS
        held = quick and bool(len(model.shapes)) and self.inputs.mode == "missing"
        fit = self._fit(step, model, held=held, thinned=thinned, report=report)
        evaluation = self._evaluation(
            fit, step, *self._prepared(step, fit, thinned=thinned), exact=not (thinned or held)
        )
        evaluation = replace(
            evaluation,
            seconds=time.perf_counter() - begun,
            cpu_seconds=time.process_time() - cpu,
        )
        if evaluation.exact:
            _keep(self._evaluations, key, evaluation)
        return evaluation

    def fit(self, step: ModelStep, report: Progress) -> Fit:
        """Return the exact fit of a step."""
        model = Model(self.robot, step.effects)
        return self._fit(step, model, held=False, thinned=False, report=report)

    def find(
        self, step: ModelStep, *, report: Progress, found: Callable[[Proposal], None]
    ) -> FoundEffects:
        """Return the effects that the model of a step lacks, or what has changed since the fit.

        Parameters
        ----------
        step : ModelStep
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
        step : ModelStep
        recording : int
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

    def _fit(
        self, step: ModelStep, model: Model, *, held: bool, thinned: bool, report: Progress
    ) -> Fit:
        """Return the fit of a step; the first of its recordings also chooses the filter."""
        if self.inputs.mode == "changed":
            assert self._opened_fit is not None
            return self._opened_fit
        key = (*step.key, held, thinned)
        if key in self._fits:
            return self._fits[key]
        start = None
        if held:
            values = [self._shapes.get(s.label, s.initial) for s in model.shapes]
            start = ShapeStart(np.array(values), held=True)
        first = self._first_fits.get((step.excluded, thinned))
        if first is None:
            train, _ = self.used(step, thinned=thinned)
            fit = identify(model, train, processing=self._processing, start=start, progress=report)
            self._first_fits[step.excluded, thinned] = fit
            self._processing = fit.processing
        else:
            train_prepared, _ = self._prepared(step, first, thinned=thinned)
            assert train_prepared is not None
            fit = train_prepared.fitted(model, first, start=start, report=report)
        if not held:
            self._shapes.update(
                {s.label: float(v) for s, v in zip(model.shapes, fit.shapes, strict=True)}
            )
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

    def _evaluation(
        self,
        fit: Fit,
        step: ModelStep,
        train: PreparedRecordings | None,
        test: PreparedRecordings | None,
        *,
        exact: bool,
    ) -> Evaluation:
        changes = step.changes
        on_train = None if train is None else train.compared(fit, changes, with_noise=test is None)
        on_test = None if test is None else test.compared(fit, changes, with_noise=True)
        shown = on_test or on_train
        assert shown is not None
        trained = on_train.rms_moving if on_train is not None else np.full(self.robot.n, np.nan)
        errors = StepErrors(
            tuple(numbers_or_none(trained)),
            tuple(numbers_or_none(fit.rms_cv if on_test is None else on_test.rms_moving)),
            tuple(numbers_or_none(shown.noise_floor)),
        )
        notes = [*fit.warnings, *(on_test.warnings if on_test is not None else ())]
        return Evaluation(
            exact=exact,
            errors=errors,
            train=on_train,
            test=on_test,
            sentence=verdict(shown),
            effects=effect_rows(fit) + change_rows(step.changes),
            warnings=tuple(dict.fromkeys(str(w) for w in notes)),
            shapes={s.label: float(v) for s, v in zip(fit.model.shapes, fit.shapes, strict=True)},
            cutoff=fit.processing.cutoff or shown.cutoff,
        )


def _keep(cache: dict[object, Kept], key: object, value: Kept, *, most: int = KEPT_RESULTS) -> None:
    """Add an entry to a cache, and drop the oldest beyond its size."""
    cache[key] = value
    while len(cache) > most:
        del cache[next(iter(cache))]
