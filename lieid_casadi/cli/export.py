"""``lieid export FIT --to c|urdf|mjcf -o DIR``: a fit for controllers and simulators."""

from __future__ import annotations

import argparse
from typing import Any

from lieid_casadi.cli import effects_file, output, shared_options
from lieid_casadi.cli.option_types import InputPath
from lieid_casadi.errors import UsageError

FORMATS = ("c", "urdf", "mjcf")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "export",
        help="write a fit as C code, as a URDF or as a MuJoCo model",
        description="Write a fit as C code for a controller, or as a URDF or a MuJoCo model for "
        "simulators.",
    )
    parser.add_argument("fit", type=InputPath, metavar="FIT", help="fit to export")
    parser.add_argument("--to", choices=FORMATS, required=True, help="C99 code, URDF, MuJoCo model")
    shared_options.add_output_folder(parser)
    parser.add_argument("--prefix", metavar="NAME", help="prefix of all C names; default: arm")
    parser.add_argument(
        "--functions",
        metavar="NAME,NAME…",
        help="C functions to write, such as torque,mass_matrix; default: all that the fit has",
    )
    parser.add_argument(
        "--runtime",
        metavar="NAME,NAME…",
        help="numbers that are arguments of the C functions: payload, parameters; default: none",
    )
    parser.add_argument("--float32", action="store_true", help="C in single precision")
    effects_file.add_option(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Write the files and print notes on their use."""
    from lieid_casadi.exporters.export import export
    from lieid_casadi.identification import Fit

    if args.prefix is not None and args.to != "c":
        raise UsageError(f"--prefix {args.prefix}: a prefix applies to C code; expected --to c")
    if args.functions is not None and args.to != "c":
        raise UsageError("--functions: a choice of functions applies to C code; expected --to c")
    for option, given in (("--runtime", args.runtime is not None), ("--float32", args.float32)):
        if given and args.to != "c":
            raise UsageError(f"{option} applies to C code; expected --to c")
    effects_file.load(args.effects_file)
    fit = Fit.load(args.fit)
    made = export(
        fit,
        args.output,
        to=args.to,
        prefix=args.prefix,
        functions=None if args.functions is None else args.functions.split(","),
        runtime=() if args.runtime is None else args.runtime.split(","),
        float32=args.float32,
        force=args.force,
    )
    output.say(f"{', '.join(path.name for path in made.files)} written to {args.output}")
    for note in made.notes:
        output.say(f"  ! {note}")
