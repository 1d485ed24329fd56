"""``lieid diagnose``: effects that a model lacks, or changes since a fit."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import inputs, options, output
from lieid_casadi.cli.check import DESPITE_CHECK, premises_of
from lieid_casadi.cli.option_types import part
from lieid_casadi.cli.options import Command, option, several
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.diagnosis import Diagnosis, DiagnosisOptions, Proposal


def run(args: argparse.Namespace) -> output.Outcome:
    """Diagnose."""
    from lieid_casadi.report import diagnosis_report

    if args.train and args.recordings:
        raise UsageError(
            f"{args.recordings[0]}: expected all recordings after --train and --test (effects that "
            "the model lacks), or none (what has changed since a FIT)"
        )
    changed = inputs.is_fit(args) and not args.train
    diagnosis, premises = _changed(args) if changed else _missing(args)
    return output.Outcome(
        lambda: print_diagnosis(diagnosis),
        fit=diagnosis.fit,
        json=diagnosis.to_dict() | {"premises": premises},
        html=lambda: diagnosis_report(diagnosis),
        plot=diagnosis.plot,
    )


#: Options of a search for missing effects; what has changed is judged with the model of the fit.
ONLY_WITH_TRAIN = (
    options.TIP,
    options.LOCK,
    option(
        "--method",
        "ordinary, weighted or robust least squares",
        default="wls",
        choices=("ols", "wls", "robust"),
    ),
    option("--interactive", "ask before each effect is added"),
    options.effects(None),
    options.MOTOR_SIDE,
    *options.PROCESSING,
)
COMMANDS = (
    Command(
        "diagnose",
        "which effects are missing, or what has changed since a fit",
        "Find the effects that a model lacks (--train; with a FIT, the search starts from the "
        "effects of its model) or what has changed since a fit (FIT REC…).",
        (
            options.ROBOT_OR_FIT[0],
            several(
                "recordings REC",
                "with a FIT and without --train: recordings measured since the fit",
                nargs="*",
            ),
            several("--train A", "recordings to fit"),
            several("--test B", options.TEST),
            options.random_seed("stated in the result; a diagnosis draws no random numbers"),
            option(
                "--worth PART",
                "least relative fall of a joint's held-out error that is a finding; default: 0.03 "
                "for missing effects, 0.1 of the error for changes since a fit",
                part,
            ),
            options.output_file("fit.json", "write the fit with the effects that were found"),
            options.plot("draw the error after each step"),
            *ONLY_WITH_TRAIN,
            *options.RECORDING,
            DESPITE_CHECK,
            options.JSON,
            options.HTML,
        ),
        run,
        usage="lieid diagnose ROBOT|FIT --train A… [--test B…] [-o fit.json] | FIT REC…",
    ),
)


def _missing(args: argparse.Namespace) -> tuple[Diagnosis, list[dict[str, Any]]]:
    """Return the diagnosis and the findings of the check before it."""
    from lieid_casadi.diagnosis import diagnose
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model

    if args.recordings:
        raise UsageError(
            f"{args.recordings[0]}: expected recordings after --train and --test, "
            "or a FIT (.json) in place of ROBOT"
        )
    if not args.train:
        raise UsageError("no recordings to fit; expected lieid diagnose ROBOT --train A… --test B…")
    robot = inputs.robot_of(args)
    fit = Fit.load(args.robot) if inputs.is_fit(args) else None
    train = inputs.recordings_of(args.train, args, fit or robot)
    test = inputs.recordings_of(args.test, args, fit or robot)
    premises = premises_of(args, robot, train, test)
    if fit is not None and args.effects is None:
        model = Model(robot, fit.model.effects)
    else:
        model = inputs.model_for(args, robot, train)
    with output.progress("diagnose") as report:
        found = diagnose(
            model,
            train,
            test or None,
            method=args.method,
            processing=inputs.processing_of(args),
            seed=args.seed,
            options=_options(args),
            ask=_asker() if args.interactive else None,
            progress=None if args.interactive else report,
        )
    return found, premises


def _changed(args: argparse.Namespace) -> tuple[Diagnosis, list[dict[str, Any]]]:
    """Return the diagnosis and the findings of the check before it."""
    from lieid_casadi.diagnosis import diagnose
    from lieid_casadi.identification import Fit

    if not args.recordings or args.test:
        raise UsageError(
            f"{args.robot}: a fit; expected the recordings measured since (lieid diagnose FIT "
            "REC…), or --train A… for the effects that its model lacks"
        )
    names = [name for each in ONLY_WITH_TRAIN if (name := each.given(args))]
    if names:
        raise UsageError(
            f"{', '.join(names)}: without --train, model and filter are those of the fit; "
            "expected --train A… too, or the command without this option"
        )
    fit = Fit.load(args.robot)
    recordings = inputs.recordings_of(args.recordings, args, fit)
    premises = premises_of(args, fit, recordings)
    with output.progress("diagnose") as report:
        found = diagnose(fit, recordings, options=_options(args), seed=args.seed, progress=report)
    return found, premises


def _options(args: argparse.Namespace) -> DiagnosisOptions:
    """Return the thresholds, with the least fall of the error if it is stated."""
    from lieid_casadi.diagnosis import DiagnosisOptions

    if args.worth is None:
        return DiagnosisOptions()
    return DiagnosisOptions(worth=args.worth, worth_of_change=args.worth)


def _asker() -> Callable[[Proposal], bool]:
    """Return a question on the terminal for each step."""
    if not sys.stdin.isatty():
        raise UsageError(
            "--interactive: standard input is not a terminal; expected one, or no option"
        )

    def ask(proposal: Proposal) -> bool:
        output.say(
            f"{proposal.label}: held-out error on joint {proposal.joint + 1} falls from "
            f"{proposal.before:.4g} to {proposal.after:.4g} N·m. Add it? [Y/n]"
        )
        return not sys.stdin.readline().strip().lower().startswith("n")

    return ask


def print_diagnosis(diagnosis: Diagnosis) -> None:
    """Print the verdict, the errors of all models, rivals, and rejected candidates."""
    from lieid_casadi.diagnosis.result import (
        alias_sentence,
        evidence_table,
        rejected_table,
    )

    for line in diagnosis.sentences:
        output.say(line)
    output.show(diagnosis.error_table(), evidence_table(diagnosis))
    if diagnosis.steps:
        output.say("lieid effects NAME describes an effect and what it is confused with.")
        if diagnosis.mode == "missing":
            effects = ",".join(diagnosis.fit.model.effects)
            output.say(f"The model with these effects: --effects '{effects}'")
    output.show(rejected_table(diagnosis))
    output.say(f"{diagnosis.tried} candidates were tried. {alias_sentence(diagnosis)}".rstrip())
    output.show_warnings(diagnosis.warnings)
