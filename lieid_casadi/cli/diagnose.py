"""``lieid diagnose``: effects that a model lacks, or changes since a fit."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import effects_file, output, shared_options, torque_options
from lieid_casadi.cli.option_types import InputPath, OutputFile, PictureFile, part, seed
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.diagnosis import Diagnosis, DiagnosisOptions, Proposal

#: Options of a search for missing effects; what has changed is judged with the model of the fit.
ONLY_WITH_TRAIN = (
    "tip", "lock", "effects", "motor_side", "method", "cutoff", "average_periods", "smoothing",
    "interactive",
)  # fmt: skip


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "diagnose",
        help="which effects are missing, or what has changed since a fit",
        usage="lieid diagnose ROBOT|FIT --train A… [--test B…] [-o fit.json] | FIT REC…",
        description="Find the effects that a model lacks (--train; with a FIT, the search starts "
        "from the effects of its model) or what has changed since a fit (FIT REC…).",
    )
    shared_options.add_robot(parser, fit=True)
    _add_recordings(parser)
    parser.add_argument(
        "--method",
        choices=("ols", "wls", "robust"),
        default="wls",
        help="ordinary, weighted or robust least squares; default: wls",
    )
    parser.add_argument(
        "--seed", type=seed, default=0, metavar="N", help="seed of the bootstrap; default: 0"
    )
    parser.add_argument(
        "--worth",
        type=part,
        metavar="PART",
        help="least relative fall of a joint's held-out error that is a finding; default: 0.03 for "
        "missing effects, 0.1 of the error for changes since a fit",
    )
    parser.add_argument(
        "--interactive", action="store_true", help="ask before each effect is added"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=OutputFile,
        metavar="fit.json",
        help="write the fit with the effects that were found",
    )
    parser.add_argument(
        "--plot", type=PictureFile, metavar="FILE", help="draw the error after each step"
    )
    shared_options.add_effects(parser, default=None)
    torque_options.add_motor_side(parser)
    shared_options.add_recording_options(parser)
    shared_options.add_processing(parser)
    shared_options.add_outputs(parser, html=True)
    shared_options.add_threads(parser)
    defaults = {name: parser.get_default(name) for name in ONLY_WITH_TRAIN}
    parser.set_defaults(run=run, only_with_train=defaults)


def _add_recordings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recordings",
        nargs="*",
        type=InputPath,
        metavar="REC",
        help="with a FIT and without --train: recordings measured since the fit",
    )
    parser.add_argument(
        "--train", nargs="+", type=InputPath, default=[], metavar="A", help="recordings to fit"
    )
    parser.add_argument(
        "--test",
        nargs="+",
        type=InputPath,
        default=[],
        metavar="B",
        help="recordings to test on, which are not fitted",
    )


def run(args: argparse.Namespace) -> None:
    """Diagnose, print and write."""
    from lieid_casadi.report import diagnosis_report

    if args.train and args.recordings:
        raise UsageError(
            f"{args.recordings[0]}: expected all recordings after --train and --test (effects that "
            "the model lacks), or none (what has changed since a FIT)"
        )
    if _is_fit(args) and not args.train:
        diagnosis = _changed(args)
    else:
        diagnosis = _missing(args)
    files = output.Files()
    files.add_fit(args.output, diagnosis.fit)
    files.add_json(args.json, diagnosis.to_dict())
    files.add_html(args.html, lambda: diagnosis_report(diagnosis))
    files.add_picture(args.plot, diagnosis.plot)
    files.write()
    print_diagnosis(diagnosis)


def _is_fit(args: argparse.Namespace) -> bool:
    return Path(args.robot).suffix.lower() == ".json"


def _missing(args: argparse.Namespace) -> Diagnosis:
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
    effects_file.load(args.effects_file)
    robot = shared_options.robot_of(args)
    fit = Fit.load(args.robot) if _is_fit(args) else None
    train = shared_options.recordings_of(args.train, args, fit or robot)
    test = shared_options.recordings_of(args.test, args, fit or robot)
    if fit is not None and args.effects is None:
        model = Model(robot, fit.model.effects)
    else:
        model = torque_options.model_for(args, robot, train)
    with output.progress("diagnose") as report:
        return diagnose(
            model,
            train,
            test or None,
            method=args.method,
            processing=shared_options.processing_of(args),
            seed=args.seed,
            options=_options(args),
            ask=_asker() if args.interactive else None,
            progress=None if args.interactive else report,
        )


def _changed(args: argparse.Namespace) -> Diagnosis:
    from lieid_casadi.diagnosis import diagnose
    from lieid_casadi.diagnosis.wording import join_words
    from lieid_casadi.identification import Fit

    if not args.recordings or args.test:
        raise UsageError(
            f"{args.robot}: a fit; expected the recordings measured since (lieid diagnose FIT "
            "REC…), or --train A… for the effects that its model lacks"
        )
    unused = [k for k, value in args.only_with_train.items() if getattr(args, k) != value]
    if unused:
        names = join_words([f"--{name.replace('_', '-')}" for name in unused])
        output.say(f"Without --train, model and filter are those of the fit: {names} not used.")
    effects_file.load(args.effects_file)
    fit = Fit.load(args.robot)
    recordings = shared_options.recordings_of(args.recordings, args, fit)
    with output.progress("diagnose") as report:
        return diagnose(fit, recordings, options=_options(args), seed=args.seed, progress=report)


def _options(args: argparse.Namespace) -> DiagnosisOptions:
    """Return the thresholds, with the least fall of the error if it is stated."""
    from lieid_casadi.diagnosis import DiagnosisOptions

    if args.worth is None:
        return DiagnosisOptions()
    return DiagnosisOptions(worth=args.worth, least_change_improvement=args.worth)


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
    from lieid_casadi.diagnosis.text_summary import (
        error_table,
        evidence_table,
        rejected_table,
        sentences,
    )

    for line in sentences(diagnosis):
        output.say(line)
    output.show(error_table(diagnosis), evidence_table(diagnosis))
    if diagnosis.steps:
        output.say("lieid effects NAME describes an effect and what it is confused with.")
        if diagnosis.mode == "missing":
            effects = ",".join(diagnosis.fit.model.effects)
            output.say(f"The model with these effects: --effects '{effects}'")
    _print_unexplained(diagnosis)
    output.show(rejected_table(diagnosis))
    output.say(f"{diagnosis.tried} candidates were tried. {diagnosis.aliases.sentence}".rstrip())
    output.show_warnings(diagnosis.warnings)


def _print_unexplained(diagnosis: Diagnosis) -> None:
    """Print the unexplained residual as code of a user-defined effect."""
    from lieid_casadi.diagnosis.residual.user_effect_code import own_effects
    from lieid_casadi.diagnosis.text_summary import rerun_options

    own = own_effects(diagnosis.unexplained)
    if own.labels:
        output.say(
            "The unexplained residual as a user-defined effect, which reduced the error of "
            "training data that its fit left out. Save these lines as F.py and run again with the "
            f"options {rerun_options(diagnosis, own.labels)}\n"
        )
        lines = ["    " + line if line else "" for line in own.code.splitlines()]
        output.say("\n".join([*lines, ""]))
