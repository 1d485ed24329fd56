"""``lieid experiment ROBOT|FIT [REC…] --record COMMAND -o DIR``: record until effects are named."""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import Args, command
from lieid_casadi.errors import LieidError, NoSolution, UsageError

if TYPE_CHECKING:
    from lieid_casadi.experiments import Experiment, PlannedMotion
    from lieid_casadi.recording import Recording
    from lieid_casadi.robot import Robot
    from lieid_casadi.tables import Table


@command(
    "experiment",
    "record, diagnose and design the next motion until every effect is named",
    usage="lieid experiment ROBOT|FIT [REC…] --record 'COMMAND {trajectory} {recording}' -o DIR",
)
def run(args: Args) -> output.Outcome:
    """Move the robot by your command, diagnose, and design the next motion, until all is named.

    The next motion separates what is still open. A second call with the same folder resumes.

    @ROBOT_OR_FIT
    recordings [REC …]: input  recordings from which to start
    --record COMMAND required  command that runs {trajectory} (CSV) on the robot and writes
        {recording} (CSV); split into arguments as by a shell, but run without one
    -o/--output DIR: resumed required  folder of the experiment
    --most N: int = 5  recordings at most
    --yes  run every motion without a question
    --page PORT: port  follow the experiment and confirm motions on a local web page
    --no-browser  do not open a browser
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
    from lieid_casadi.report import experiment_report

    if not (args.yes or args.page or sys.stdin.isatty()):
        raise UsageError(
            "standard input is not a terminal, so that no motion can be confirmed; expected a "
            "terminal, --page PORT, or --yes to run every motion without a question"
        )
    robot = inputs.robot_of(args)
    source = inputs.fit_of(args, args.robot) if inputs.is_fit(args) else robot

    def load(path: Path) -> Recording:
        return inputs.recordings_of([str(path)], args, source)[0]

    command = RecordCommand.parse(args.record, load)
    given = inputs.recordings_of(args.recordings, args, source)
    stated = args.effects is not None or args.motor_side
    page = None if args.page is None else _Page(args, robot)
    if page is not None:
        shown_by: Any = nullcontext(page.progress)
    else:  # a bar would hide the question
        shown_by = output.progress("experiment") if args.yes else nullcontext(lambda *_: None)
    asked = None if args.yes else _confirmed
    try:
        with shown_by as report:
            result = experiment(
                inputs.model_for(args, robot, given) if stated else source, given,
                record=command, folder=args.output, most=args.most,
                confirm=asked if page is None else page.confirm, load=load,
                despite_check=args.despite_check, start_pose=args.start_pose or None,
                acceleration=args.acceleration or None, margin=args.margin,
                limits=inputs.limits_of(args, robot), longest=args.longest, probe=args.probe,
                rate=args.rate, seed=args.seed, progress=report,
            )  # fmt: skip
    except LieidError as error:
        if page is not None:
            page.end(f"The experiment failed: {error}")
        raise
    if page is not None:
        page.end(*result.sentences)
    if result.stopped == "record_failed":
        raise NoSolution(
            f"{result.reason} The same command resumes the experiment in {args.output}"
        )
    return output.Outcome(
        tuple(shown(result)), json=result.to_dict(), html=lambda: experiment_report(result)
    )


def _confirmed(motion: PlannedMotion) -> bool:
    """Show a motion and ask whether to run it."""
    output.show(*motion.sentences, "Run it on the robot? [y/N]")
    return sys.stdin.readline().strip().lower() in ("y", "yes")


class _Page:
    """The experiment's page, served by a process of its own, and the answers of its user."""

    def __init__(self, args: Args, robot: Robot) -> None:
        from lieid_casadi.workbench.arm import arm_meshes
        from lieid_casadi.workbench.experiment_page import ExperimentState, serve_experiment
        from lieid_casadi.workbench.server import open_in_browser

        self._robot, self._asks, self._told = robot, not args.yes, 0.0
        meshes = arm_meshes(robot, args.robot)
        state = ExperimentState(
            robot.name, Path(args.output).absolute(), meshes, args.yes, begun=args.yes
        )
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        given = (theirs, args.page, state)
        context.Process(target=serve_experiment, args=given, daemon=True).start()
        theirs.close()
        url = self._pipe.recv()
        if isinstance(url, LieidError):
            raise url
        print(url, flush=True)
        if not args.no_browser:
            open_in_browser(url)
        if not args.yes:
            self._answer("start")
            self._send(begun=True)

    def progress(self, stage: str, fraction: float) -> None:
        """Show a stage, a few times per second."""
        if time.monotonic() - self._told > 0.1:
            self._told = time.monotonic()
            self._send(stage=stage, fraction=fraction)

    def confirm(self, motion: PlannedMotion) -> bool:
        """Show a motion, and return whether to run it; ask unless all are to be run."""
        from lieid_casadi.workbench.arm import arm_motion

        while not self._asks and self._pipe.poll():
            self._asks = self._pipe.recv() == "pause"
        samples = arm_motion(self._robot, motion.samples.t, motion.samples.q)
        self._send(motion=samples, sentences=motion.sentences, asks=self._asks)
        answer = self._answer("run", "end", "continue") if self._asks else "run"
        self._asks = self._asks and answer != "continue"
        self._send(asks=False, stage=f"record {motion.number}", fraction=0.0)
        return answer != "end"

    def end(self, *sentences: str) -> None:
        """Show why it ended until the user closes the page."""
        self._send(ended="\n".join(sentences), stage="", fraction=1.0)
        if self._asks:
            self._answer("close")

    def _answer(self, *expected: str) -> str:
        """Wait for one of these answers; without a page it is ``end``."""
        with suppress(EOFError, OSError):
            while (word := str(self._pipe.recv())) not in expected:
                pass
            return word
        return "end"

    def _send(self, **shown: Any) -> None:
        with suppress(OSError):  # the page was ended
            self._pipe.send(shown)


def shown(result: Experiment) -> Iterator[str | Table]:
    """Yield why it ended, what was found, the rounds, and doubts about recordings."""
    yield from result.sentences
    yield result.table()
    for each in result.rounds:
        for warning in each.warnings:
            yield f"  ! Recording {each.number}: {warning}"
    yield f"Files in {result.folder}; with a larger --most the same command goes on."
