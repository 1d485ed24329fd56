"""``lieid workbench [ROBOT|FIT] [REC…]``: the model against recordings, on a local web page."""

from __future__ import annotations

import argparse
import functools
from typing import TYPE_CHECKING, NoReturn

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, options, output
from lieid_casadi.cli.options import command
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.workbench.session import Options, WorkbenchInputs


@command(
    "workbench",
    "compare, diagnose and extend a model on a local web page",
    usage="lieid workbench [ROBOT|FIT] [REC…] [--train A…] [--test B…] [options]",
)
def run(args: argparse.Namespace) -> None:
    """Open a local web page that shows where a model fails, and which effects it lacks.

    It shows how the error falls with each of them. Without arguments it opens the simulated arm of
    the demo.

    robot [ROBOT|FIT]: input = ''  robot, or a fit (.json) whose model is fitted again
    recordings [REC …]: input  recordings; the last of several is the test and the others are
        fitted
    --train REC …: input  recordings to fit
    --test REC …: input  recordings to test on
    @NO_EFFECTS @TIP_AND_LOCK @RECORDING
    --port N: port = 8765  port to listen on, on this machine alone; from another one: ssh -L
    --no-browser  do not open a browser
    """
    from lieid_casadi.workbench.server import serve
    from lieid_casadi.workbench.session import WorkerSetup

    setup = WorkerSetup(
        prepare=functools.partial(inputs.load_effects_file, args.effects_file),
        robot=load_robot,
        read=read_recordings,
    )
    setup.prepare()  # an error ends the command before a page is served
    opened = inputs_of(args)
    check_recordings(args, opened)
    ready = functools.partial(_announce, browser=not args.no_browser)
    serve(opened, setup, args.port, ready=ready)


#: Options that a page keeps, but for the number of threads.
KEPT_OPTIONS = "@TIP_AND_LOCK @RECORDING"


def inputs_of(args: argparse.Namespace) -> WorkbenchInputs:
    """Return what the command line opens."""
    from lieid_casadi.demo import DEMO_ROBOT
    from lieid_casadi.workbench.session import RecordingInput, WorkbenchInputs

    if not args.robot:
        if args.train or args.test:
            raise UsageError("recordings were given without a robot; expected ROBOT or FIT first")
        args.robot = DEMO_ROBOT
        return demo_inputs()
    is_fit = inputs.is_fit(args)
    train, test = list(args.train), list(args.test)
    if args.recordings and (train or test):
        raise UsageError(
            f"{args.recordings[0]}: expected all recordings after --train and --test, or none"
        )
    if args.recordings:
        last = max(len(args.recordings) - 1, 1)
        train, test = list(args.recordings[:last]), list(args.recordings[last:])
    robot = inputs.robot_of(args)
    effects = tuple(p.label for p in lieid.Model(robot, args.effects).placements)
    return WorkbenchInputs(
        robot="" if is_fit else str(args.robot),
        fit=str(args.robot) if is_fit else "",
        recordings=(
            *(RecordingInput(str(path), "train") for path in train),
            *(RecordingInput(str(path), "test") for path in test),
        ),
        effects=effects,
        options=stated_options(args),
    )


def check_recordings(args: argparse.Namespace, opened: WorkbenchInputs) -> None:
    """Read the recordings, so that an error in one of them ends the command in one line."""
    source = lieid.Fit.load(opened.fit) if opened.fit else inputs.robot_of(args)
    for recording in opened.recordings:
        inputs.recordings_of([recording.path], args, source)


def demo_inputs() -> WorkbenchInputs:
    """Return the demo's simulated arm; it is recorded on the first call, which takes seconds."""
    from lieid_casadi.demo import DEMO_ROBOT, demo_recordings
    from lieid_casadi.workbench.session import RecordingInput, WorkbenchInputs

    with output.progress("measure the simulated arm") as report:
        train, test = demo_recordings(report)
    return WorkbenchInputs(
        robot=DEMO_ROBOT,
        recordings=(RecordingInput(str(train), "train"), RecordingInput(str(test), "test")),
    )


def stated_options(args: argparse.Namespace) -> Options:
    """Return the options that a page keeps, and shows in its commands: name and values."""
    found = []
    for name, value in options.given(KEPT_OPTIONS, args).items():
        if name != "--threads":
            values = [] if value is True else value if isinstance(value, list) else [value]
            found.append((name.removeprefix("--"), tuple(map(str, values))))
    return tuple(found)


def load_robot(opened: WorkbenchInputs) -> lieid.Robot:
    """Return the robot of a page's inputs."""
    return inputs.robot_of(_arguments(opened))


def read_recordings(
    opened: WorkbenchInputs, source: lieid.Robot | lieid.Fit
) -> list[lieid.Recording]:
    """Load the recordings of a page's inputs."""
    return inputs.recordings_of([r.path for r in opened.recordings], _arguments(opened), source)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors do not end the process."""

    def error(self, message: str) -> NoReturn:
        """Raise the message."""
        raise UsageError(" ".join(message.split()))


def _arguments(opened: WorkbenchInputs) -> argparse.Namespace:
    """Return the command line that opens what a page has open."""
    parser = _Parser(allow_abbrev=False)
    options.COMMANDS["workbench"].add_to("workbench", parser.add_subparsers())
    train = ["--train", *opened.paths("train")]
    return parser.parse_args(["workbench", opened.fit or opened.robot, *train, *opened.words])


def _announce(url: str, *, browser: bool) -> None:
    """Print the URL, and open it in the user's browser."""
    print(url, flush=True)
    if browser:
        from lieid_casadi.workbench.server import open_in_browser

        open_in_browser(url)
