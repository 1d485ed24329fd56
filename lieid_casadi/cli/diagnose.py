"""``lieid diagnose``: effects that a model lacks, or changes since a fit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, options, output
from lieid_casadi.cli.check import premises_of
from lieid_casadi.cli.options import Args, command
from lieid_casadi.errors import LieidWarning, UsageError
from lieid_casadi.tables import Table

if TYPE_CHECKING:
    from lieid_casadi.diagnosis import DiagnosisOptions


@command(
    "diagnose",
    "which effects are missing, or what has changed since a fit",
    usage="lieid diagnose ROBOT|FIT --train A… [--test B…] [-o fit.json] | FIT REC…",
)
def run(args: Args) -> output.Outcome:
    """Find the effects that a model lacks, or what has changed since a fit.

    With --train, the effects that a model lacks (with a FIT, the search starts from the effects of
    its model); with FIT REC…, what has changed since the fit.

    robot ROBOT|FIT: input  URDF, MJCF or YAML file, or a bundled name, or a fit (JSON)
    recordings [REC …]: input  with a FIT and without --train: recordings measured since the
        fit
    --train A …: input  recordings to fit
    --test B …: input  recordings to test on, which are not fitted
    --seed N: seed = 0  stated in the result; a diagnosis draws no random numbers
    --worth PART: part  least relative fall of a joint's held-out error that is a finding;
        default: 0.03 for missing effects, 0.1 of the error for changes since a fit
    -o/--output fit.json: output  write the fit with the effects that were found; FIT as it was
        with FIT REC…
    @ONLY_WITH_TRAIN @RECORDING @DESPITE_CHECK @JSON @HTML
    """
    from lieid_casadi.report import diagnosis_report

    if args.train and args.recordings:
        raise UsageError(
            f"{args.recordings[0]}: expected all recordings after --train and --test (effects that "
            "the model lacks), or none (what has changed since a FIT)"
        )
    changed = inputs.is_fit(args) and not args.train
    diagnosis, premises = _changed(args) if changed else _missing(args)
    return output.Outcome(
        tuple(shown(diagnosis)),
        fit=diagnosis.fit,
        json=diagnosis.to_dict() | {"premises": premises},
        html=lambda: diagnosis_report(diagnosis),
    )


def _missing(args: Args) -> tuple[lieid.Diagnosis, list[dict[str, Any]]]:
    """Return the diagnosis and the findings of the check before it."""
    if args.recordings:
        raise UsageError(
            f"{args.recordings[0]}: expected recordings after --train and --test, "
            "or a FIT (.json) in place of ROBOT"
        )
    if not args.train:
        raise UsageError("no recordings to fit; expected lieid diagnose ROBOT --train A… --test B…")
    robot = inputs.robot_of(args)
    fit = lieid.Fit.load(args.robot) if inputs.is_fit(args) else None
    train = inputs.recordings_of(args.train, args, fit or robot)
    test = inputs.recordings_of(args.test, args, fit or robot)
    premises = premises_of(args, robot, train, test)
    if fit is not None and args.effects is None:
        model = lieid.Model(robot, fit.model.effects)
    else:
        model = inputs.model_for(args, robot, train)
    with output.progress("diagnose") as report:
        found = lieid.diagnose(
            model,
            train,
            test or None,
            method=args.method,
            processing=lieid.Processing(cutoff=args.cutoff),
            seed=args.seed,
            options=_options(args),
            progress=report,
        )
    return found, premises


def _changed(args: Args) -> tuple[lieid.Diagnosis, list[dict[str, Any]]]:
    """Return the diagnosis and the findings of the check before it."""
    if not args.recordings or args.test:
        raise UsageError(
            f"{args.robot}: a fit; expected the recordings measured since (lieid diagnose FIT "
            "REC…), or --train A… for the effects that its model lacks"
        )
    if names := options.given("@ONLY_WITH_TRAIN", args):
        raise UsageError(
            f"{', '.join(names)}: without --train, model and filter are those of the fit; "
            "expected --train A… too, or the command without this option"
        )
    fit = lieid.Fit.load(args.robot)
    recordings = inputs.recordings_of(args.recordings, args, fit)
    premises = premises_of(args, fit, recordings)
    with output.progress("diagnose") as report:
        found = lieid.diagnose(
            fit, recordings, options=_options(args), seed=args.seed, progress=report
        )
    return found, premises


def _options(args: Args) -> DiagnosisOptions:
    """Return the thresholds, with the least fall of the error if it is stated."""
    from lieid_casadi.diagnosis import DiagnosisOptions

    if args.worth is None:
        return DiagnosisOptions()
    return DiagnosisOptions(worth=args.worth, worth_of_change=args.worth)


def shown(diagnosis: lieid.Diagnosis) -> Iterator[str | Table | LieidWarning]:
    """Yield the verdict, the errors of all models, rivals, and rejected candidates."""
    from lieid_casadi.diagnosis.result import (
        alias_sentence,
        evidence_table,
        motion_table,
        rejected_table,
    )

    yield from filter(None, [*diagnosis.sentences, diagnosis.summary])
    yield diagnosis.error_table()
    yield motion_table(diagnosis)
    yield evidence_table(diagnosis)
    if diagnosis.steps:
        yield "lieid effects NAME describes an effect and what it is confused with."
        if diagnosis.mode == "missing":
            effects = ",".join(diagnosis.fit.model.effects)
            without = any(event.kind != "standstill" for event in diagnosis.events)
            where = ", fitted without what is left out" if without else ""
            yield f"The model with these effects{where}: --effects '{effects}'"
        else:
            yield "The fit is kept as it was; what has changed is not in it."
    yield rejected_table(diagnosis)
    if not diagnosis.rejected:  # whose table states it
        yield f"{diagnosis.tried} candidates were tried."
    if aliases := alias_sentence(diagnosis):
        yield aliases
    yield from diagnosis.warnings
