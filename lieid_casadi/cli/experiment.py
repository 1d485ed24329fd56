"""``lieid experiment ROBOT|FIT [REC…] --record COMMAND -o DIR``: record until effects are named."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import command
from lieid_casadi.errors import NoSolution, UsageError

if TYPE_CHECKING:
    from lieid_casadi.experiments import Experiment, PlannedMotion
    from lieid_casadi.recording import Recording
    from lieid_casadi.tables import Table


@command(
    "experiment",
    "record, diagnose and design the next motion until every effect is named",
    usage="lieid experiment ROBOT|FIT [REC…] --record 'COMMAND {trajectory} {recording}' -o DIR",
)
def run(args: argparse.Namespace) -> output.Outcome:
    """Move the robot by your command, diagnose, and design the next motion, until all is named.

    The next motion separates what is still open. A second call with the same folder resumes.

    @ROBOT_OR_FIT
    recordings [REC …]: input  recordings from which to start
    --record COMMAND required  command that runs {trajectory} (CSV) on the robot and writes
        {recording} (CSV); split into arguments as by a shell, but run without one
    -o/--output DIR: resumed required  folder of the experiment
    --most N: int = 5  recordings at most
    --yes  run every motion without a question
    --longest S: number = 20  length of a motion, s
    --probe S: number = 3  length of the probe motion at the start of each, s; 0 for none
    --start-pose Q …: number  pose at the start and the end, rad; default: a pose found
        within all limits
    --rate HZ: number = 1000  sampling rate of the trajectories, Hz
    --seed N: seed = 0  seed of the searches for motions
    @LIMITS @EFFECTS_BY_RECORDING @RECORDING @DESPITE_CHECK @JSON @HTML
    """
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
    stated = args.effects is not None or args.motor_side
    # a bar would hide the question
    with output.progress("experiment") if args.yes else nullcontext(_silent) as report:
        result = experiment(
            inputs.model_for(args, robot, given) if stated else source, given,
            record=command, folder=args.output, most=args.most,
            confirm=None if args.yes else _confirmed, load=load,
            despite_check=args.despite_check, start_pose=args.start_pose or None,
            acceleration=args.acceleration or None, margin=args.margin,
            limits=inputs.limits_of(args, robot), longest=args.longest, probe=args.probe,
            rate=args.rate, seed=args.seed, progress=report,
        )  # fmt: skip
    if result.stopped == "record_failed":
        raise NoSolution(
            f"{result.reason} The same command resumes the experiment in {args.output}"
        )
    return output.Outcome(
        tuple(shown(result)), json=result.to_dict(), html=lambda: experiment_report(result)
    )


def _silent(stage: str, fraction: float) -> None:
    """Show no progress."""


def _confirmed(motion: PlannedMotion) -> bool:
    """Show a motion and ask whether to run it."""
    output.show(
        f"Recording {motion.number}: {motion.purpose.why} {motion.promise}",
        f"The robot moves for {motion.duration:.3g} s along {motion.folder}/trajectory.csv.",
        f"Checked: {'; '.join(motion.checked)}.",
        f"Not checked: {'; '.join(motion.unchecked)}.",
        "Run it on the robot? [y/N]",
    )
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def shown(result: Experiment) -> Iterator[str | Table]:
    """Yield why it ended, what was found, the rounds, and doubts about recordings."""
    yield from result.sentences
    yield result.table()
    for each in result.rounds:
        for warning in each.warnings:
            yield f"  ! Recording {each.number}: {warning}"
    yield f"Files in {result.folder}; with a larger --most the same command goes on."
