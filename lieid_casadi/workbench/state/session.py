"""State of one page: what is open, and the steps taken so far; every change is a new object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from lieid_casadi.workbench.state.inputs import ExcludedRange, WorkbenchInputs
from lieid_casadi.workbench.state.proposals import FoundEffects, ProposedEffect

START = "first model"


@dataclass(frozen=True)
class StepErrors:
    """Errors of one step per joint, N·m, in motion; None where unknown.

    ``shown`` is of the test recordings, or held out by cross-validation without a test.
    """

    train: tuple[float | None, ...]
    shown: tuple[float | None, ...]
    noise_floor: tuple[float | None, ...]


@dataclass(frozen=True)
class ModelStep:
    """One entry of the history: a model, and what is left out of the recordings.

    Attributes
    ----------
    title : str
    effects : tuple of str
        Labels of all placements of the model: ``stribeck:4``.
    excluded : tuple of ExcludedRange
    errors : StepErrors or None
        None until they are computed.
    changes : tuple of ProposedEffect
        Since a fit that is kept, which are added to its torque.
    """

    title: str
    effects: tuple[str, ...]
    excluded: tuple[ExcludedRange, ...] = ()
    errors: StepErrors | None = None
    changes: tuple[ProposedEffect, ...] = ()

    @property
    def key(self) -> tuple[object, ...]:
        """What its torque depends on besides the inputs."""
        return self.effects, self.excluded, self.changes

    @property
    def effects_and_changes(self) -> tuple[str, ...]:
        """Labels of the effects of the model, then of the changes."""
        return (*self.effects, *(change.label for change in self.changes))


@dataclass(frozen=True)
class Session:
    """What a page shows, as it is saved.

    Attributes
    ----------
    inputs : WorkbenchInputs
    history : tuple of ModelStep
    position : int
        Of the step that is shown; those after it can be restored by `redone`.
    found : FoundEffects or None
        Of the last diagnosis.
    joint : int
        The selected one, from 0.
    recording : int
        The recording that is replayed and plotted.
    degrees : bool
        Whether angles are shown in degrees.
    """

    inputs: WorkbenchInputs = field(default_factory=WorkbenchInputs)
    history: tuple[ModelStep, ...] = ()
    position: int = 0
    found: FoundEffects | None = None
    joint: int = 0
    recording: int = 0
    degrees: bool = False

    @property
    def step(self) -> ModelStep | None:
        """The step that is shown."""
        return self.history[self.position] if self.history else None

    @property
    def summary(self) -> str:
        """The changes since the first model, in the order of the history."""
        return ", ".join(step.title for step in self.history[1:]) or START

    @property
    def can_undo(self) -> bool:
        """Whether there is an earlier step."""
        return self.position > 0

    @property
    def can_redo(self) -> bool:
        """Whether there is a step that was undone."""
        return self.position + 1 < len(self.history)

    def opened(self, inputs: WorkbenchInputs, effects: Sequence[str]) -> Session:
        """Return the session of new inputs, with the first model's effects as its only step."""
        tested = [k for k, r in enumerate(inputs.recordings) if r.role == "test"]
        return Session(
            inputs=inputs,
            history=(ModelStep(START, tuple(effects)),),
            recording=tested[0] if tested else 0,
            degrees=self.degrees,
        )

    def with_effects(self, title: str, effects: Sequence[str]) -> Session:
        """Return the session with a further step of other effects."""
        assert self.step is not None
        return self._then(replace(self.step, title=title, effects=tuple(effects), errors=None))

    def with_effect(self, label: str) -> Session:
        """Return the session with an effect added; unchanged if the model has it."""
        assert self.step is not None
        if label in self.step.effects:
            return self
        return self.with_effects(f"+ {label}", (*self.step.effects, label))

    def with_change(self, proposed: ProposedEffect) -> Session:
        """Return the session with a further step, in which a change since the fit is added."""
        step = self.step
        assert step is not None
        if proposed in step.changes:
            return self
        title = f"with the change {proposed.label}"
        changes = (*step.changes, proposed)
        return self._then(replace(step, title=title, changes=changes, errors=None))

    def without_effect(self, label: str) -> Session:
        """Return the session with an effect removed; unchanged if the model lacks it."""
        assert self.step is not None
        if label not in self.step.effects:
            return self
        return self.with_effects(f"− {label}", [e for e in self.step.effects if e != label])

    def excluding(self, start: float, end: float) -> Session:
        """Return the session without a stretch of the recording that is shown, s."""
        assert self.step is not None
        stretch = ExcludedRange(self.recording, start, end)
        title = f"without {start:.4g} to {end:.4g} s of recording {self.recording + 1}"
        return self._then(
            replace(self.step, title=title, excluded=(*self.step.excluded, stretch), errors=None)
        )

    def with_errors(self, step: ModelStep, errors: StepErrors) -> Session:
        """Return the session with the errors of every step that has the same fit as ``step``."""
        history = tuple(
            replace(each, errors=errors) if each.key == step.key else each for each in self.history
        )
        return replace(self, history=history)

    def at_worst_joint(self) -> Session:
        """Return the session with the joint selected whose error is most above its noise floor."""
        errors = None if self.step is None else self.step.errors
        if errors is None:
            return self
        ratios = [
            error / floor if error and floor else 0.0
            for error, floor in zip(errors.shown, errors.noise_floor, strict=True)
        ]
        return replace(self, joint=ratios.index(max(ratios)))

    def show_recording(self, recording: int) -> Session:
        """Return the session with another recording in the plots."""
        return replace(self, recording=recording)

    def undone(self) -> Session:
        """Return the session one step back."""
        return replace(self, position=max(self.position - 1, 0))

    def redone(self) -> Session:
        """Return the session one step forward."""
        return replace(self, position=min(self.position + 1, max(len(self.history) - 1, 0)))

    def at(self, position: int) -> Session:
        """Return the session at a step of its history."""
        return replace(self, position=min(max(position, 0), max(len(self.history) - 1, 0)))

    def _then(self, step: ModelStep) -> Session:
        history = (*self.history[: self.position + 1], step)
        return replace(self, history=history, position=len(history) - 1)
