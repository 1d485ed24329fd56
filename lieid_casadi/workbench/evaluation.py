"""What the page shows of a fit: plain data, so that it can be sent between processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.series import Series, effect_torques
from lieid_casadi.diagnosis import Diagnosis, Step
from lieid_casadi.diagnosis.findings import finding, unexplained_sentence
from lieid_casadi.effects import Effect
from lieid_casadi.effects.registry import make
from lieid_casadi.identification import Fit
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.messages import in_unit
from lieid_casadi.model import Model
from lieid_casadi.recording import Processing, Recording, check, process
from lieid_casadi.tables import Table, figures, make_table, with_std
from lieid_casadi.workbench.arm import ArmMesh, arm_meshes
from lieid_casadi.workbench.session import FoundEffects, ProposedEffect, Session, StepErrors

LONGEST = 40.0  # s of the recording that the curves of effects are made of
POINTS = 160
#: Units (turning, sliding joint) of the signals in the order in which one is chosen for the axis.
AXES = {
    "temperature": ("°C", "°C"),
    "load": ("N·m", "N"),
    "time": ("s", "s"),
    "ddq": ("rad/s²", "m/s²"),
    "dq": ("rad/s", "m/s"),
    "q": ("rad", "m"),
}


@dataclass(frozen=True)
class OpenedRecording:
    """Facts about one recording: first and last time in s, warnings."""

    name: str
    start: float
    end: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class OpenedInputs:
    """What was opened."""

    robot: str
    joint_names: tuple[str, ...]
    units: tuple[str, ...]  # of torque
    revolute: tuple[bool, ...]
    effects: tuple[str, ...]  # of the first model
    recordings: tuple[OpenedRecording, ...]
    meshes: tuple[ArmMesh, ...]


def opened_inputs(model: Model, recordings: Sequence[Recording], *, file: str) -> OpenedInputs:
    """Return facts about the first model and the recordings, which are checked."""
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
                start=float(r.t[0]),
                end=float(r.t[-1]),
                warnings=tuple(str(w) for w in check(r, robot)),
            )
            for r in recordings
        ),
        meshes=arm_meshes(robot, file),
    )


@dataclass(frozen=True)
class EffectRow:
    """One effect of the model on one joint (from 0; None: on the whole arm).

    ``values`` are its parameters as text, ``name = value ± std unit``.
    """

    label: str
    joint: int | None
    values: tuple[str, ...]

    @property
    def effect(self) -> Effect:
        """Its definition."""
        return make(self.label.partition(":")[0])


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A fitted model compared with all recordings.

    It is ``exact`` unless it was fitted to parts of the recordings (its errors are then the larger
    ones of two fits), and ``complete`` if it has standard deviations and a noise floor of its own.
    """

    exact: bool
    complete: bool
    errors: StepErrors
    train: Comparison
    test: Comparison | None
    sentence: str
    effects: tuple[EffectRow, ...]
    cutoff: float
    processing: Processing | None = None


def series_of(evaluation: Evaluation | None, title: str) -> list[Series]:
    """Return the series of one recording, in the order of time."""
    parts = [] if evaluation is None else [evaluation.train, evaluation.test]
    return [
        series
        for comparison in parts
        if comparison is not None
        for series in comparison.series
        if series.recording == title or series.recording.startswith(f"{title}@")
    ]


def difference_tables(
    session: Session, position: int, evaluations: tuple[Evaluation, Evaluation], joint: int | None
) -> list[Table]:
    """Return the errors of the model at ``position`` and of the shown one, and other effects."""
    models = [f"model {position + 1}", f"model {session.position + 1}"]
    errors = zip(*(each.errors.shown for each in evaluations), strict=True)
    rows = [
        [
            j,
            figures(a),
            figures(b),
            f"{100.0 * (b / a - 1.0):+z.0f} %" if a and b is not None else None,
        ]
        for j, (a, b) in enumerate(errors, start=1)
    ]
    values: dict[str, list[str]] = {}
    for k, each in enumerate(evaluations):
        for row in each.effects:
            if joint is None or row.joint in (joint, None):
                values.setdefault(row.label, ["–", "–"])[k] = ", ".join(row.values)
    place = "" if joint is None else f" on joint {joint + 1}"
    return [
        make_table(f"RMS error, {session.error_name}, N·m", ["joint", *models, "change"], rows),
        make_table(
            f"Effects that differ{place}",
            ["effect", *models],
            [[label, *both] for label, both in values.items() if both[0] != both[1]],
        ),
    ]


def effect_rows(fit: Fit) -> tuple[EffectRow, ...]:
    """Return one row per effect and joint, in the model's order."""
    numbers = list(zip(fit.fitted, fit.parameter_table(), strict=True))
    rows = []
    for p in fit.model.placements:
        own = [row for parameter, row in numbers if parameter.belongs_to(p)]
        shown = tuple(
            parameter_text(row["name"].rpartition(".")[2], row["value"], row["std"], row["unit"])
            for row in own
        )
        absorbed = f"{p.effect.label} is not identifiable apart from the other parameters"
        joint = None if p.whole_arm else p.joint
        rows.append(EffectRow(p.label, joint, shown or (absorbed,)))
    return tuple(rows)


def parameter_text(name: str, value: float, std: float | None, unit: str) -> str:
    """Return a parameter as the page shows it.

    Examples
    --------
    >>> parameter_text("f_c", 17.552, 0.853, "N·m"), parameter_text("g", 0.02, None, "1")
    ('f_c = 17.55 ± 0.85 N·m', 'g = 0.02')
    """
    return f"{name} = {in_unit(with_std(value, std), unit)}"


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
    signals = {"load": load, "time": np.repeat(segment.t[:, None], segment.n, axis=1)}
    curves = {}
    for placement, torque in effect_torques(fit, segment):
        name = _axis(placement.effect)
        values = signals.get(name, getattr(segment, name, None))
        if placement.whole_arm or values is None:
            continue
        joint = placement.joint
        x = values[:, joint if placement.source is None else placement.source]
        rows = np.linspace(0, len(x) - 1, POINTS).astype(int)
        unit = AXES[name][0 if fit.model.robot.joints[joint].revolute else 1]
        curves[placement.label] = EffectCurve(
            name, unit, tuple(x[rows].tolist()), tuple(torque[rows, joint].tolist())
        )
    return curves


def _axis(effect: Effect) -> str:
    """Return the signal over which an effect is shown."""
    if "q" in effect.signals and "sign" not in effect.signals:
        return "q"
    used = {*effect.signals, *(["dq"] if "sign" in effect.signals else [])}
    return next((name for name in AXES if name in used), "dq")


def found_effects(diagnosis: Diagnosis, effects: tuple[str, ...]) -> FoundEffects:
    """Return what a diagnosis of a model with these effects found."""
    model = diagnosis.fit.model
    path = diagnosis.shown[1]
    return FoundEffects(
        verdict=diagnosis.verdict,
        sentence=diagnosis.sentence,
        proposed=tuple(_proposed(step, path[-1]) for step in diagnosis.steps),
        effects=effects,
        unexplained=tuple(map(unexplained_sentence, diagnosis.unexplained)),
        model=tuple(p.label for p in model.placements),
        path=tuple(tuple(numbers_or_none(errors)) for errors in path),
        summary=diagnosis.summary,
    )


def _proposed(step: Step, errors: Array) -> ProposedEffect:
    """Return a step for the page; ``errors`` (n,) are those of the final fit that it shows, N·m."""
    before, after = step.before, step.after
    if step.fall.test is not None:  # as the list of joints: of the test
        after = float(errors[step.joint])
        before = after + step.fall.test
    return ProposedEffect(
        label=step.label,
        effect=step.effect,
        joints=tuple(j + 1 for j in step.joints),
        joint=step.joint,
        before=number_or_none(before),
        after=number_or_none(after),
        rivals=tuple((rival.label, rival.kind) for rival in step.rivals),
        value=", ".join(
            parameter_text(name, value, step.std.get(name), step.units.get(name, ""))
            for name, value in step.parameters.items()
        ),
        status=step.status,
        sentence=finding([step], "missing"),
        group=step.group,
    )
