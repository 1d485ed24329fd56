"""``lieid gains ROBOT --unloaded REC… --loaded REC… --mass KG``: drive gains in N·m/A."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from lieid_casadi.cli import inputs, options, output
from lieid_casadi.cli.option_types import OutputFile, number
from lieid_casadi.cli.options import Command, option, several
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.gains import DriveGains


def run(args: argparse.Namespace) -> output.Outcome:
    """Identify the gains."""
    from lieid_casadi.gains import drive_gains
    from lieid_casadi.robot.yaml_file import write_yaml

    if not args.mass > 0.0:
        raise UsageError(f"--mass {args.mass:g}: expected kg above 0")
    robot = inputs.model_of(args).robot
    with output.progress("gains") as report:
        gains = drive_gains(
            robot,
            inputs.currents_of(args.unloaded, args, robot),
            inputs.currents_of(args.loaded, args, robot),
            mass=args.mass,
            com=args.com,
            effects=args.effects,
            processing=inputs.processing_of(args),
            progress=report,
        )
    return output.Outcome(
        lambda: print_gains(gains),
        json=gains.to_dict(),
        plot=gains.plot,
        files={"yaml": lambda: write_yaml(gains.robot_with_gains()).encode()},
    )


COMMANDS = (
    Command(
        "gains",
        "drive gains in N·m/A, from currents and a payload of known mass",
        "Determine the drive gains in N·m/A from motor currents with and without a payload of "
        "known mass.",
        (
            *options.ROBOT,
            several("--unloaded REC", "recordings of currents without the payload", required=True),
            several("--loaded REC", "recordings of currents with the payload", required=True),
            option("--mass KG", "mass of the payload", number, required=True),
            option(
                "--com",
                "the payload's centre of mass in the tool frame, m, if it was measured",
                number,
                nargs=3,
                metavar=("X", "Y", "Z"),
            ),
            option("--yaml FILE", "write the robot with its torque constants", OutputFile),
            options.plot("draw the gains"),
            options.effects(),
            options.EFFECTS_FILE,
            *options.READING,
            *options.PROCESSING,
            options.JSON,
            options.THREADS,
        ),
        run,
    ),
)


def print_gains(gains: DriveGains) -> None:
    """Print the gains, those not identified, and the option for other commands."""
    from lieid_casadi.gains.identify import gain_table

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
