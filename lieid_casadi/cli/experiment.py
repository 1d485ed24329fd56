"""``lieid experiment ROBOT|FIT [REC…] --record COMMAND -o DIR``: record until effects are named."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lieid_casadi.cli import inputs, motion_limits, options, output
from lieid_casadi.cli.check import DESPITE_CHECK
from lieid_casadi.cli.option_types import number
from lieid_casadi.cli.options import Command, option, several
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.experiments import Experiment, PlannedMotion
    from lieid_casadi.recording import Recording

NO_RECORDING = 3  # exit status where the command failed; everything before it is kept


def run(args: argparse.Namespace) -> output.Outcome:
    """Run the experiment."""
    from lieid_casadi.experiments import experiment
    from lieid_casadi.experiments.record import RecordCommand
    from lieid_casadi.identification import Fit
    from lieid_casadi.report import experiment_report

    if not args.yes and not sys.stdin.isatty():
        raise UsageError(
            "standard input is not a terminal, so that no motion can be confirmed; expected a "
            "terminal, or --yes to run every motion without a question"
        )
    robot = inputs.robot_of(args)
    source = Fit.load(args.robot) if inputs.is_fit(args) else robot

    def load(path: Path) -> Recording:
        return inputs.recordings_of([str(path)], args, source)[0]

    command = RecordCommand.parse(args.record, load)
    given = inputs.recordings_of(args.recordings, args, source)
    if args.effects is not None or args.motor_side:
        model = inputs.model_for(args, robot, given)
    elif isinstance(source, Fit):
        model = source
    else:
        model = robot
    with output.progress("experiment") as report:
        result = experiment(
            model, given, record=command, folder=args.output, most=args.most,
            confirm=None if args.yes else _confirmed, load=load,
            despite_check=args.despite_check, start_pose=args.start_pose,
            acceleration=args.acceleration, margin=args.margin,
            limits=motion_limits.limits_of(args, robot), longest=args.longest, probe=args.probe,
            rate=args.rate, seed=args.seed, progress=report,
        )  # fmt: skip
    return output.Outcome(
        lambda: show(result),
        json=result.to_dict(),
        html=lambda: experiment_report(result),
        status=NO_RECORDING if result.stopped == "record_failed" else 0,
    )


COMMANDS = (
    Command(
        "experiment",
        "record, diagnose and design the next motion until every effect is named",
        "Move the robot by your command, diagnose, and design the motion that separates what is "
        "still open, until every effect is named. A second call with the same folder resumes.",
        (
            *options.ROBOT_OR_FIT,
            several("recordings REC", "recordings from which to start", nargs="*"),
            option(
                "--record COMMAND",
                "command that runs {trajectory} (CSV) on the robot and writes {recording} (CSV); "
                "split into arguments as by a shell, but run without one",
                required=True,
            ),
            option("-o/--output DIR", "folder of the experiment", required=True),
            option("--most N", "recordings at most", int, 5),
            option("--yes", "run every motion without a question"),
            option("--longest S", "length of a motion, s", number, 20.0),
            option("--probe S", "length of the probe motion at its start, s; 0: none", number, 3.0),
            option("--rate HZ", "sampling rate of the trajectories, Hz", number, 1000.0),
            motion_limits.START_POSE,
            motion_limits.LIMITS,
            options.effects(None),
            options.MOTOR_SIDE,
            options.random_seed("seed of the searches for motions"),
            *options.RECORDING,
            DESPITE_CHECK,
            options.JSON,
            options.HTML,
        ),
        run,
        usage="lieid experiment ROBOT|FIT [REC…] --record 'COMMAND {trajectory} {recording}' -o DIR",
    ),
)


def _confirmed(motion: PlannedMotion) -> bool:
    """Show a motion and ask whether to run it."""
    output.say(f"Recording {motion.number}: {motion.purpose.why} {motion.promise}")
    output.say(f"The robot moves for {motion.duration:.3g} s along {motion.folder}/trajectory.csv.")
    output.say(f"Checked: {'; '.join(motion.checked)}.")
    output.say(f"Not checked: {'; '.join(motion.unchecked)}.")
    output.say("Run it on the robot? [y/N]")
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def show(result: Experiment) -> None:
    """Print why it ended, what was found, and the rounds."""
    if result.stopped == "record_failed":
        print(f"lieid experiment: {result.reason}", file=sys.stderr)
    for line in result.sentences:
        output.say(line)
    output.show(result.table())
    for each in result.rounds:
        for warning in each.warnings:
            output.say(f"  ! Recording {each.number}: {warning}")
    output.say(f"Files in {result.folder}; the same command resumes the experiment.")
