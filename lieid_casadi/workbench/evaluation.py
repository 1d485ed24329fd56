"""What the page shows of a fit: plain data, so that it can be sent between processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.comparison import verdict
from lieid_casadi.comparison.series import effect_torques
from lieid_casadi.diagnosis import Diagnosis, DiagnosisStep
from lieid_casadi.effects import Effect, Placement
from lieid_casadi.effects.registry import make
from lieid_casadi.identification import Fit
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed, Recording, check, process
from lieid_casadi.workbench.arm import ArmMesh, ArmSolid, arm_meshes, arm_solids
from lieid_casadi.workbench.recordings import NoiseFloor, PreparedRecordings
from lieid_casadi.workbench.session import (
    FoundEffects,
    ModelStep,
    ProposedEffect,
    StepErrors,
)


@dataclass(frozen=True)
class OpenedRecording:
    """Facts about one recording, for the list of what is open."""

    name: str
    rows: int
    start: float
    end: float
    rate: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class OpenedInputs:
    """What was opened.

    Attributes
    ----------
    robot : str
        Name of the robot.
    joint_names, units : tuple of str
        Of each joint: its name, and N·m or N.
    effects : tuple of str
        Labels of the placements of the first model.
    expected : tuple of float or None
        Held-out error of an opened fit, N·m.
    meshes : tuple of ArmMesh
        Of a URDF whose files are found; they replace the capsules.
    """

    robot: str
    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    revolute: tuple[bool, ...]
    effects: tuple[str, ...]
    expected: tuple[float | None, ...]
    recordings: tuple[OpenedRecording, ...]
    solids: tuple[ArmSolid, ...]
    meshes: tuple[ArmMesh, ...]


@dataclass(frozen=True)
class EffectCurve:
    """Fitted torque of an effect, N·m or N, at values of the signal ``name``."""

    name: str
    unit: str
    signal: tuple[float, ...]
    torque: tuple[float, ...]


@dataclass(frozen=True)
class SimulationError:
    """How far a simulation leaves the measured motion within short windows.

    Attributes
    ----------
    window : float
        s.
    rms : tuple of float or None
        At the ends of the windows, per joint, rad or m.
    reason : str
        Why there is no simulation; empty if there is one.
    """

    window: float
    rms: tuple[float | None, ...]
    reason: str


@dataclass(frozen=True, eq=False)
class EffectRow:
    """One effect of the model on one joint.

    ``values`` are its parameters as text, ``name = value ± std unit``.
    """

    label: str
    effect: str
    joint: int | None
    formula: str
    values: tuple[str, ...]


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
        if the fit is kept. The series of a recording are named after it, see `recording_title`.
    sentence : str
        How large the error is, compared with the noise.
    shapes : dict
        Label of each shape parameter → its value, from which later fits start.
    cutoff : float
        Hz.
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
    seconds: float = 0.0
    cpu_seconds: float = 0.0


SEARCH_EFFECTS = "“Find what is missing” searches the library of effects"
SEARCH_CHANGES = "“Find what has changed” searches for changes since the fit"


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


def evaluate_fit(
    fit: Fit,
    train: PreparedRecordings | None,
    test: PreparedRecordings | None,
    changes: Sequence[ProposedEffect],
    *,
    effort: Effort,
    noise: NoiseFloor | None,
) -> Evaluation:
    """Compare a fit with all recordings of a step.

    Parameters
    ----------
    train, test : PreparedRecordings or None
        At least one of them; no training if an opened fit is kept.
    changes : sequence of ProposedEffect
        Since the fit.
    effort : Effort
        Of the fit.
    noise : NoiseFloor or None
        Estimated if None.
    """
    on_train = on_test = None
    if train is not None:
        on_train = train.compared(fit, changes, noise=noise, with_noise=test is None)
    if test is not None:
        on_test = test.compared(fit, changes, noise=noise)
    shown = on_test or on_train
    assert shown is not None
    trained = on_train.rms_moving if on_train is not None else np.full(fit.model.n, np.nan)
    errors = StepErrors(
        tuple(numbers_or_none(trained)),
        tuple(numbers_or_none(fit.rms_cv if on_test is None else on_test.rms_moving)),
        tuple(numbers_or_none(shown.noise_floor)),
    )
    notes = [*fit.warnings, *(on_test.warnings if on_test is not None else ())]
    return Evaluation(
        exact=not (effort.held or effort.thinned),
        complete=effort == Effort(),
        errors=errors,
        train=on_train,
        test=on_test,
        sentence=verdict(shown, remedy=SEARCH_EFFECTS if train else SEARCH_CHANGES),
        effects=effect_rows(fit) + change_rows(changes),
        warnings=tuple(dict.fromkeys(str(w) for w in notes)),
        shapes={s.label: float(v) for s, v in zip(fit.model.shapes, fit.shapes, strict=True)},
        cutoff=fit.processing.cutoff or shown.cutoff,
    )


def effect_rows(fit: Fit) -> tuple[EffectRow, ...]:
    """Return one row per effect and joint, in the model's order."""
    values: dict[tuple[str, int], list[str]] = {}
    for row in fit.parameter_table():
        name, _, parameter = row["name"].rpartition(".")
        values.setdefault((name, row["joint"] - 1), []).append(_text(parameter, row))
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


def change_rows(changes: Sequence[ProposedEffect]) -> tuple[EffectRow, ...]:
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


def _text(parameter: str, row: dict[str, object]) -> str:
    unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
    std = "" if row["std"] is None else f" ± {row['std']:.2g}"
    return f"{parameter} = {row['value']:.4g}{std}{unit}"


def _not_identified(placement: Placement) -> str:
    return f"{placement.effect.label} is not identifiable apart from the other parameters"


LONGEST = 40.0  # s of the recording that the curves are made of
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
        unit = next(
            u if fit.model.robot.joints[joint].revolute else s for n, u, s in AXES if n == name
        )
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


def found_effects(diagnosis: Diagnosis, step: ModelStep) -> FoundEffects:
    """Return what a diagnosis of a step's model proposes."""
    return FoundEffects(
        verdict=diagnosis.verdict,
        sentence=diagnosis.sentence,
        proposed=tuple(_proposed(each) for each in diagnosis.steps),
        effects=step.effects,
        unexplained=tuple(
            f"joint {part.joint + 1}: {part.relation}" for part in diagnosis.unexplained
        ),
        shapes=tuple(
            (parameter.label, float(value))
            for parameter, value in zip(
                diagnosis.fit.model.shapes, diagnosis.fit.shapes, strict=True
            )
        ),
    )


def _proposed(step: DiagnosisStep) -> ProposedEffect:
    content = step.to_dict()
    return ProposedEffect(
        label=step.label,
        effect=step.effect,
        joints=tuple(j + 1 for j in step.joints),
        joint=_joint(step),
        before=number_or_none(step.evidence.held_out_before),
        after=number_or_none(step.evidence.held_out_after),
        selected=content.get("selected"),
        confirmed=step.evidence.confirmed,
        rivals=tuple((c.placement.label, kind) for c, kind in step.indistinguishable),
        value=", ".join(
            f"{name} = {value:.4g}{'' if step.units[name] == '1' else ' ' + step.units[name]}"
            for name, value in step.parameters.items()
        ),
        parameters=tuple(step.parameters.items()),
    )


def _joint(step: DiagnosisStep) -> int:
    """Return the joint, from 0, that an effect is listed under."""
    return step.joints[0] if step.joints else 0


def opened_inputs(
    model: Model, recordings: Sequence[Recording], kept: Fit | None, *, file: str
) -> OpenedInputs:
    """Return facts about the first model and the recordings, which are checked.

    Parameters
    ----------
    kept : Fit or None
        The fit that is kept, if it is not fitted again.
    file : str
        Of the robot or fit, near which its meshes are looked for.
    """
    robot = model.robot
    return OpenedInputs(
        robot=robot.name,
        joint_names=tuple(joint.name for joint in robot.joints),
        units=tuple("N·m" if joint.revolute else "N" for joint in robot.joints),
        revolute=tuple(joint.revolute for joint in robot.joints),
        effects=tuple(p.label for p in model.placements),
        expected=(None,) * robot.n if kept is None else tuple(numbers_or_none(kept.rms_cv)),
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
