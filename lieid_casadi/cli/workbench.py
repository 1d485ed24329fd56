"""``lieid workbench [ROBOT|FIT] [REC…]``: the model against recordings, on a local web page."""

from __future__ import annotations

import argparse
import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import effects_file, output, shared_options
from lieid_casadi.cli.option_types import InputPath
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.identification import Fit
    from lieid_casadi.recording import Recording
    from lieid_casadi.robot import Robot
    from lieid_casadi.workbench.session import WorkbenchInputs

#: Options that a page saves as text, and shows in its commands.
OPTIONS = (
    "stiffness", "damping", "servo", "episodes", "calibration", "inflate-limit", "effects-file",
)  # fmt: skip


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "workbench",
        help="compare, diagnose and extend a model on a local web page",
        description="Open a local web page that shows where a model fails, which effects it lacks, "
        "and how the error falls with each of them. Without arguments it opens the simulated arm "
        "of the demo.",
        usage="lieid workbench [ROBOT|FIT] [REC…] [--train A…] [--test B…] [options]",
    )
    parser.add_argument(
        "robot",
        nargs="?",
        type=InputPath,
        default="",
        metavar="ROBOT|FIT",
        help="robot to fit a model of, or a fit (.json) to compare with recordings measured since",
    )
    parser.add_argument(
        "recordings",
        nargs="*",
        type=InputPath,
        metavar="REC",
        help="recordings; of a robot, the last of several is the test and the others are fitted",
    )
    for name, meaning in (("train", "recordings to fit"), ("test", "recordings to test on")):
        parser.add_argument(
            f"--{name}", nargs="+", type=InputPath, default=[], metavar="REC", help=meaning
        )
    parser.add_argument("--tip", metavar="LINK", help="last link of the chain (URDF, MJCF)")
    parser.add_argument("--lock", nargs="+", default=[], metavar="JOINT", help="joints to lock")
    shared_options.add_effects(parser, default="")
    shared_options.add_recording_options(parser)
    shared_options.add_threads(parser)
    _add_server_options(parser)
    parser.set_defaults(run=run)


def _add_server_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("server")
    group.add_argument(
        "--port", type=_port, default=8765, metavar="N", help="port to listen on; default: 8765"
    )
    group.add_argument("--no-browser", action="store_true", help="do not open a browser")
    group.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="address to listen on"
    )
    group.add_argument(
        "--yes-expose",
        action="store_true",
        help="confirm a --host that other machines can reach; an SSH tunnel is safer",
    )


def run(args: argparse.Namespace) -> None:
    """Serve the page until the program is asked to end."""
    from lieid_casadi.workbench.recordings import WorkerSetup
    from lieid_casadi.workbench.server import ServerOptions, serve

    setup = WorkerSetup(
        prepare=functools.partial(effects_file.load, args.effects_file),
        robot=functools.partial(load_robot, args),
        read=functools.partial(read_recordings, args),
    )
    setup.prepare()  # an error ends the command before a page is served
    inputs = inputs_of(args)
    check_recordings(args, inputs)
    options = ServerOptions(args.host, args.port, exposed=args.yes_expose)
    serve(inputs, setup, options, ready=functools.partial(_announce, browser=not args.no_browser))


def inputs_of(args: argparse.Namespace) -> WorkbenchInputs:
    """Return what the command line opens.

    Raises
    ------
    LieidError
        A robot, fit or effect that cannot be loaded, or recordings without a robot.
    """
    from lieid_casadi.demo import DEMO_ROBOT
    from lieid_casadi.model import Model
    from lieid_casadi.workbench.session import RecordingInput, WorkbenchInputs

    if not args.robot:
        if args.train or args.test:
            raise UsageError("recordings were given without a robot; expected ROBOT or FIT first")
        args.robot = DEMO_ROBOT
        return demo_inputs()
    is_fit = Path(args.robot).suffix.lower() == ".json"
    train, test = list(args.train), list(args.test)
    kept = is_fit and not train and not test
    if kept:
        test = list(args.recordings)
    elif args.recordings and (train or test):
        raise UsageError(
            f"{args.recordings[0]}: expected all recordings after --train and --test, or none"
        )
    elif args.recordings:
        last = len(args.recordings) - 1
        train, test = (
            list(args.recordings[: last or 1]),
            list(args.recordings[last:] if last else []),
        )
    robot = shared_options.robot_of(args)
    effects = tuple(p.label for p in Model(robot, args.effects).placements)
    if kept and effects:
        raise UsageError("--effects: a fit that is kept has its own effects; expected --train too")
    return WorkbenchInputs(
        robot="" if is_fit else str(args.robot),
        fit=str(args.robot) if is_fit else "",
        mode="changed" if kept else "missing",
        recordings=(
            *(RecordingInput(str(path), "train") for path in train),
            *(RecordingInput(str(path), "test") for path in test),
        ),
        effects=effects,
        torque_constants=args.torque_constants or "",
        units=args.units,
        options=tuple((name, str(getattr(args, _key(name)))) for name in _stated(args)),
        tip=args.tip or "",
        lock=tuple(args.lock),
    )


def check_recordings(args: argparse.Namespace, inputs: WorkbenchInputs) -> None:
    """Read the recordings, so that an error in one of them ends the command.

    Raises
    ------
    LieidError
        In one line, as in the other commands.
    """
    from lieid_casadi.identification import Fit

    source = Fit.load(inputs.fit) if inputs.fit else shared_options.robot_of(args)
    for recording in inputs.recordings:
        shared_options.recordings_of([recording.path], args, source)


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


def load_robot(args: argparse.Namespace, inputs: WorkbenchInputs) -> Robot:
    """Return the robot of a page's inputs, with the options of the command line."""
    return shared_options.robot_of(_with_inputs(args, inputs))


def read_recordings(
    args: argparse.Namespace, inputs: WorkbenchInputs, source: Robot | Fit
) -> list[Recording]:
    """Load the recordings of a page's inputs, with the options of the command line.

    Parameters
    ----------
    args : Namespace
    inputs : WorkbenchInputs
        Its texts take the place of the options.
    source : Robot or Fit
    """
    paths = [r.path for r in inputs.recordings]
    return shared_options.recordings_of(paths, _with_inputs(args, inputs), source)


def _with_inputs(args: argparse.Namespace, inputs: WorkbenchInputs) -> argparse.Namespace:
    """Return the command line as if it had opened what a page has open."""
    stated = dict(inputs.options)
    limit = stated.get("inflate-limit")
    return argparse.Namespace(
        **{
            **vars(args),
            **{_key(name): stated.get(name) for name in OPTIONS},
            "inflate_limit": args.inflate_limit if limit is None else float(limit),
            "robot": inputs.fit or inputs.robot,
            "tip": inputs.tip or None,
            "lock": inputs.lock,
            "torque_constants": inputs.torque_constants or None,
            "units": inputs.units,
        }
    )


def _stated(args: argparse.Namespace) -> list[str]:
    return [name for name in OPTIONS if getattr(args, _key(name)) is not None]


def _key(option: str) -> str:
    return option.replace("-", "_")


def _announce(url: str, *, browser: bool) -> None:
    """Print the URL, and open it in the user's browser."""
    print(url, flush=True)
    if browser:
        import threading
        import webbrowser

        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()


def _port(text: str) -> int:
    if not (text.isdecimal() and len(text) < 6 and 1 <= int(text) < 65536):
        raise argparse.ArgumentTypeError(f"{text}: expected a port, 1 to 65535")
    return int(text)
