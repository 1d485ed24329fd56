"""What the page shows of a fit: plain data, so that it can be sent between processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.comparison import verdict_sentences
from lieid_casadi.comparison.series import effect_torques
from lieid_casadi.diagnosis import Diagnosis, Step
from lieid_casadi.diagnosis.findings import finding, unexplained_sentence
from lieid_casadi.effects import Effect, Placement
from lieid_casadi.effects.registry import make
from lieid_casadi.identification import Fit
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed, Processing, Recording, check, process
from lieid_casadi.workbench.arm import ArmMesh, ArmSolid, arm_meshes, arm_solids
from lieid_casadi.workbench.recordings import NoiseFloor, PreparedRecordings
from lieid_casadi.workbench.session import (
    FoundEffects,
    Numbers,
    ProposedEffect,
    StepErrors,
)

SEARCH_EFFECTS = "“Find what is missing” searches the library of effects"
SEARCH_CHANGES = "“Find what has changed” searches for changes since the fit"
LONGEST = 40.0  # s of the recording that the curves of effects are made of
POINTS = 160
#: Signals in the order in which one is chosen for the axis: name, unit (turning, sliding joint).
AXES = (
    ("temperature", "°C", "°C"),
    ("load", "N·m", "N"),
    ("time", "s", "s"),
    ("ddq", "rad/s²", "m/s²"),
    ("dq", "rad/s", "m/s"),
    ("q", "rad", "m"),
)


@dataclass(frozen=True)
class OpenedRecording:
    """Facts about one recording: its rows, first and last time in s, rate in Hz, warnings."""

    name: str
    rows: int
    start: float
    end: float
    rate: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class OpenedInputs:
    """What was opened.

    ``units`` are those of each joint's torque, N·m or N; ``effects`` the labels of the first
    model's placements; ``meshes`` those of a URDF whose files are found, in place of capsules.
    """

    robot: str
    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    revolute: tuple[bool, ...]
    effects: tuple[str, ...]
    recordings: tuple[OpenedRecording, ...]
    solids: tuple[ArmSolid, ...]
    meshes: tuple[ArmMesh, ...]


def opened_inputs(model: Model, recordings: Sequence[Recording], *, file: str) -> OpenedInputs:
    """Return facts about the first model and the recordings, which are checked.

    ``file`` is that of the robot or fit, near which its meshes are looked for.
    """
    robot = model.robot
    return OpenedInputs(
        robot=robot.name,
        joint_names=tuple(joint.name for joint in robot.joints),
        units=tuple("N·m" if joint.revolute else "N" for joint in robot.joints),
        revolute=tuple(joint.revolute for joint in robot.joints),
        effects=tuple(p.label for p in model.placements),
        recordings=tuple(
            OpenedRecording(
                name=r.name,
                rows=len(r),
                start=float(r.t[0]),
                end=float(r.t[-1]),
                rate=float(r.rate),
                warnings=tuple(str(w) for w in check(r, robot)),
            )
            for r in recordings
        ),
        solids=arm_solids(robot),
        meshes=arm_meshes(robot, file),
    )


@dataclass(frozen=True)
class SimulationError:
    """How far a simulation leaves the measured motion at the ends of windows of some seconds.

    Per joint, rad or m; ``reason`` says why there is no simulation, and is empty if there is one.
    """

    window: float
    rms: Numbers
    reason: str


@dataclass(frozen=True)
class EffectRow:
    """One effect of the model on one joint (from 0; None: on the whole arm).

    ``values`` are its parameters as text, ``name = value ± std unit``.
    """

    label: str
    effect: str
    joint: int | None
    formula: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class Effort:
    """What a fit leaves out, so that its errors can be shown early.

    Attributes
    ----------
    held : bool
        Shape parameters are held.
    thinned : bool
        Only evenly spread parts of the recordings are used.
    brief : bool
        Standard deviations are not computed, and the noise floor is that of the model before.
    """

    held: bool = False
    thinned: bool = False
    brief: bool = False


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A fitted model compared with all recordings.

    Attributes
    ----------
    exact : bool
        False if shape parameters were held or only parts of the recordings were used.
    complete : bool
        Whether it is exact, with the standard deviations and the noise floor of this model.
    train, test : Comparison or None
        With the recordings that were fitted, and with the others; ``test`` holds all recordings
        if the fit is kept. The series of a recording are named after it, see `recording_titles`.
    sentence : str
        How large the error is, compared with the noise; one statement a line.
    shapes : dict
        Label of each shape parameter → its value, from which later fits start.
    cutoff : float
        Of the filter in ``processing``, Hz.
    seconds, cpu_seconds : float
        Time that the computation took, and that of the processor.
    """

    exact: bool
    complete: bool
    errors: StepErrors
    train: Comparison | None
    test: Comparison | None
    sentence: str
    effects: tuple[EffectRow, ...]
    warnings: tuple[str, ...]
    shapes: dict[str, float]
    cutoff: float
    processing: Processing | None = None
    seconds: float = 0.0
    cpu_seconds: float = 0.0

    @property
    def shown(self) -> Comparison | None:
        """The comparison whose errors are shown: with the test, if there is one."""
        return self.test or self.train


def evaluate_fit(
    fit: Fit,
    train: PreparedRecordings | None,
    test: PreparedRecordings | None,
    changes: Sequence[ProposedEffect],
    *,
    effort: Effort,
    noise: NoiseFloor | None,
) -> Evaluation:
    """Compare a fit, with changes since it, with all recordings of a step.

    There is no training if an opened fit is kept. The noise floor is estimated if None.
    """
    on_train = on_test = None
    if train is not None:
        on_train = train.compared(fit, changes, noise=noise, with_noise=test is None)
    if test is not None:
        on_test = test.compared(fit, changes, noise=noise)
    shown = on_test or on_train
    assert shown is not None
    trained = on_train.rms_moving if on_train is not None else np.full(fit.model.n, np.nan)
    error = fit.rms_cv if on_test is None else on_test.rms_moving
    columns = (trained, error, shown.noise_floor, _spread(shown))
    notes = [*fit.warnings, *(on_test.warnings if on_test is not None else ())]
    return Evaluation(
        exact=not (effort.held or effort.thinned),
        complete=effort == Effort(),
        errors=StepErrors(*(tuple(numbers_or_none(values)) for values in columns)),
        train=on_train,
        test=on_test,
        sentence="\n".join(verdict_sentences(shown, SEARCH_EFFECTS if train else SEARCH_CHANGES)),
        effects=_effect_rows(fit) + _change_rows(changes),
        warnings=tuple(dict.fromkeys(str(w) for w in notes)),
        shapes={s.label: float(v) for s, v in zip(fit.model.shapes, fit.shapes, strict=True)},
        cutoff=fit.processing.cutoff or shown.cutoff,
        processing=fit.processing,
    )


def _spread(comparison: Comparison) -> Array:
    """Return the standard deviation of the measured torque in motion (n,), NaN at rest, N·m."""
    measured = np.concatenate([s.measured for s in comparison.series])
    moving = np.concatenate([s.moving for s in comparison.series])
    values = [torque[use] for torque, use in zip(measured.T, moving.T, strict=True)]
    return np.array([part.std() if part.size else np.nan for part in values])


def _effect_rows(fit: Fit) -> tuple[EffectRow, ...]:
    """Return one row per effect and joint, in the model's order."""
    values: dict[tuple[str, int], list[str]] = {}
    for row in fit.parameter_table():
        name, _, parameter = row["name"].rpartition(".")
        values.setdefault((name, row["joint"] - 1), []).append(
            value_text(parameter, row["value"], row["std"], row["unit"])
        )
    return tuple(
        EffectRow(
            label=placement.label,
            effect=placement.effect.name,
            joint=None if placement.whole_arm else placement.joint,
            formula=placement.effect.formula,
            values=tuple(values.get((placement.effect.label, placement.joint), ()))
            or (_not_identified(placement),),
        )
        for placement in fit.model.placements
    )


def _change_rows(changes: Sequence[ProposedEffect]) -> tuple[EffectRow, ...]:
    """Return one row per change since a fit."""
    return tuple(
        EffectRow(
            label=change.label,
            effect=change.effect,
            joint=change.joints[0] - 1 if change.joints else None,
            formula=make(change.label.partition(":")[0]).formula,
            values=(f"change: {change.value}",),
        )
        for change in changes
    )


def value_text(name: str, value: float, std: float | None, unit: str) -> str:
    """Return a parameter as the page shows it.

    Examples
    --------
    >>> value_text("f_c", 17.552, 0.853, "N·m"), value_text("g", 0.02, None, "1")
    ('f_c = 17.55 ± 0.85 N·m', 'g = 0.02')
    """
    deviation = "" if std is None else f" ± {std:.2g}"
    return f"{name} = {value:.4g}{deviation}{'' if unit in ('', '1') else ' ' + unit}"


def _not_identified(placement: Placement) -> str:
    return f"{placement.effect.label} is not identifiable apart from the other parameters"


@dataclass(frozen=True)
class EffectCurve:
    """Fitted torque of an effect, N·m or N, at values of the signal ``name``."""

    name: str
    unit: str
    signal: tuple[float, ...]
    torque: tuple[float, ...]


def effect_curves(fit: Fit, recording: Recording) -> dict[str, EffectCurve]:
    """Return the curve of every effect that acts on one joint, by its label."""
    start = float(recording.t[0])
    part = recording if recording.duration <= LONGEST else recording.cut(start, start + LONGEST)
    segment = process([part], fit.processing)[0]
    load = fit.compiled.inverse_dynamics(segment.q, segment.dq, segment.ddq, fit.link_parameters)
    curves = {}
    for each in effect_torques(fit, segment):
        joint, effect = each.placement.joint, each.placement.effect
        if each.placement.whole_arm:
            continue
        name = _axis(effect)
        source = joint if each.placement.source is None else each.placement.source
        signal = _signal(name, segment, load)
        if signal is None:
            continue
        x = signal if signal.ndim == 1 else signal[:, source]
        rows = np.linspace(0, len(x) - 1, POINTS).astype(int)
        units = next(units for n, *units in AXES if n == name)
        unit = units[0] if fit.model.robot.joints[joint].revolute else units[1]
        curves[each.placement.label] = EffectCurve(
            name, unit, tuple(x[rows].tolist()), tuple(each.torque[rows, joint].tolist())
        )
    return curves


def _axis(effect: Effect) -> str:
    """Return the signal over which an effect is shown."""
    if "q" in effect.signals and "sign" not in effect.signals:
        return "q"
    used = {*effect.signals, *(["dq"] if "sign" in effect.signals else [])}
    return next((name for name, _, _ in AXES if name in used), "dq")


def _signal(name: str, segment: Processed, load: Array) -> Array | None:
    if name == "load":
        return load
    if name == "time":
        return segment.t
    return getattr(segment, name)  # type: ignore[no-any-return]


def found_effects(diagnosis: Diagnosis, effects: tuple[str, ...]) -> FoundEffects:
    """Return what a diagnosis of a model with these effects found."""
    model = diagnosis.fit.model
    shapes = zip(model.shapes, diagnosis.fit.shapes, strict=True)
    changed = diagnosis.mode == "changed"
    path = diagnosis.shown[1]
    return FoundEffects(
        verdict=diagnosis.verdict,
        sentence=diagnosis.sentence,
        proposed=tuple(_proposed(step, diagnosis.mode, path[-1]) for step in diagnosis.steps),
        effects=effects,
        unexplained=tuple(map(unexplained_sentence, diagnosis.unexplained)),
        shapes=tuple((parameter.label, float(value)) for parameter, value in shapes),
        model=() if changed else tuple(p.label for p in model.placements),
        path=tuple(tuple(numbers_or_none(errors)) for errors in path),
    )


def _proposed(step: Step, mode: str, errors: Array) -> ProposedEffect:
    """Return a step for the page; ``errors`` (n,) are those of the final fit that it shows, N·m."""
    before, after = step.before, step.after
    if mode == "missing" and step.fall.test is not None:  # as the list of joints: of the test
        after = float(errors[step.joint])
        before = after + step.fall.test
    return ProposedEffect(
        label=step.label,
        effect=step.effect,
        joints=tuple(j + 1 for j in step.joints),
        joint=step.joint,
        before=number_or_none(before),
        after=number_or_none(after),
        selected=step.evidence.selected,
        confirmed=step.confirmed,
        rivals=tuple((rival.label, rival.kind) for rival in step.rivals),
        value=", ".join(
            value_text(name, value, step.std.get(name), step.units.get(name, ""))
            for name, value in step.parameters.items()
        ),
        parameters=tuple(step.parameters.items()),
        status=step.status,
        sentence=finding([step], mode),
        group=step.group,
    )
