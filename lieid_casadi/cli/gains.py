"""``lieid gains ROBOT --unloaded REC… --loaded REC… --mass KG``: drive gains in N·m/A."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import output, shared_options
from lieid_casadi.cli.option_types import InputPath, OutputFile, PictureFile, number
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.gains import DriveGains
    from lieid_casadi.recording import Recording
    from lieid_casadi.robot import Robot


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "gains",
        help="drive gains in N·m/A, from currents and a payload of known mass",
        description="Determine the drive gains in N·m/A from motor currents with and without a "
        "payload of known mass.",
    )
    shared_options.add_robot(parser)
    parser.add_argument(
        "--unloaded",
        nargs="+",
        type=InputPath,
        required=True,
        metavar="REC",
        help="recordings of currents without the payload",
    )
    parser.add_argument(
        "--loaded",
        nargs="+",
        type=InputPath,
        required=True,
        metavar="REC",
        help="recordings of currents with the payload",
    )
    parser.add_argument(
        "--mass", type=number, required=True, metavar="KG", help="mass of the payload"
    )
    parser.add_argument(
        "--com",
        nargs=3,
        type=number,
        metavar=("X", "Y", "Z"),
        help="the payload's centre of mass in the tool frame, m, if it was measured",
    )
    parser.add_argument(
        "--yaml",
        type=OutputFile,
        metavar="FILE",
        help="write the robot with its torque constants",
    )
    parser.add_argument("--plot", type=PictureFile, metavar="FILE", help="draw the gains")
    shared_options.add_effects(parser)
    shared_options.add_reading_options(parser)
    shared_options.add_processing(parser)
    shared_options.add_outputs(parser)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Identify, print and write."""
    from lieid_casadi.gains import drive_gains
    from lieid_casadi.robot.yaml_file import write_yaml

    if not args.mass > 0.0:
        raise UsageError(f"--mass {args.mass:g}: expected kg above 0")
    model = shared_options.model_of(args)
    robot = model.robot
    with output.progress("gains") as report:
        gains = drive_gains(
            robot,
            _currents(args.unloaded, args, robot),
            _currents(args.loaded, args, robot),
            mass=args.mass,
            com=args.com,
            effects=args.effects,
            processing=shared_options.processing_of(args),
            progress=report,
        )
    files = output.Files()
    files.add(args.yaml, lambda: write_yaml(gains.robot_with_gains()).encode())
    files.add_json(args.json, gains.to_dict())
    files.add_picture(args.plot, gains.plot)
    files.write()
    print_gains(gains)


def _currents(paths: list[str], args: argparse.Namespace, robot: Robot) -> list[Recording]:
    from lieid_casadi.recording import Recording

    options = shared_options.reading_options_of(args, robot)
    return [Recording.load(path, **options) for path in paths]


def print_gains(gains: DriveGains) -> None:
    """Print the gains, those not identified, and the option for other commands."""
    from lieid_casadi.gains.view import gain_table

    output.show(gain_table(gains))
    for part in gains.not_identified:
        output.say(f"  * the gain of joint {part.joint + 1} cannot be identified: {part.reason}.")
    centre = ", ".join(
        "not identified" if c != c else f"{1000 * c:.1f} ± {1000 * s:.1f}"
        for c, s in zip(gains.com, gains.com_std, strict=True)
    )
    output.say(f"Centre of mass of the payload in the tool frame: ({centre}) mm.")
    if gains.option is not None:
        output.say(f"Option for the other commands:\n{gains.option}")
    output.show_warnings(gains.warnings)
