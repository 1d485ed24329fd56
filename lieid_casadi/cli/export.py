"""``lieid export FIT --to FORMAT -o DIR``: a fit for controllers and simulators."""

from __future__ import annotations

import argparse

from lieid_casadi.cli import options, output
from lieid_casadi.cli.option_types import InputPath
from lieid_casadi.cli.options import Command, option
from lieid_casadi.errors import UsageError

FORMATS = ("c", "urdf", "mjcf", "isaaclab", "ur-friction")


def run(args: argparse.Namespace) -> output.Outcome:
    """Write the files and print notes on their use."""
    from lieid_casadi.exporters.export import export
    from lieid_casadi.identification import Fit

    for name, given, what in (
        (f"--prefix {args.prefix}:", args.prefix is not None, "a prefix applies"),
        ("--functions:", args.functions is not None, "a choice of functions applies"),
        ("--runtime", args.runtime is not None, "applies"),
        ("--float32", args.float32, "applies"),
    ):
        if given and args.to != "c":
            raise UsageError(f"{name} {what} to C code; expected --to c")
    made = export(
        Fit.load(args.fit),
        args.output,
        to=args.to,
        prefix=args.prefix,
        functions=None if args.functions is None else args.functions.split(","),
        runtime=() if args.runtime is None else args.runtime.split(","),
        float32=args.float32,
        compensated=None if args.compensated is None else Fit.load(args.compensated),
        force=args.force,
    )

    def show() -> None:
        output.say(f"{', '.join(path.name for path in made.files)} written to {args.output}")
        for note in made.notes:
            output.say(f"  ! {note}")

    return output.Outcome(show)


COMMANDS = (
    Command(
        "export",
        "write a fit as C code, as a URDF or as a MuJoCo model",
        "Write a fit as C code for a controller, or as a URDF or a MuJoCo model for simulators.",
        (
            option("fit FIT", "fit to export", InputPath),
            option(
                "--to",
                "C99 code, URDF, MuJoCo model, Isaac Lab's actuators, friction of UR's driver",
                choices=FORMATS,
                required=True,
            ),
            *options.output_folder(),
            option("--prefix NAME", "prefix of all C names; default: arm"),
            option(
                "--functions NAME,NAME…",
                "C functions to write, such as torque,mass_matrix; default: all that the fit has",
            ),
            option(
                "--runtime NAME,NAME…",
                "numbers that are arguments of the C functions: payload, parameters; default: none",
            ),
            option("--float32", "C in single precision"),
            option(
                "--compensated FIT2",
                "for ur-friction: fit of motion under direct torque with the default scales",
                InputPath,
            ),
            options.EFFECTS_FILE,
        ),
        run,
    ),
)
