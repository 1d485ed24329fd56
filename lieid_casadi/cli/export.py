"""``lieid export FIT --to FORMAT -o DIR``: a fit for controllers and simulators."""

from __future__ import annotations

import lieid_casadi as lieid
from lieid_casadi.cli import output
from lieid_casadi.cli.options import Args, command
from lieid_casadi.errors import UsageError


@command("export", "write a fit as C code, as a URDF or as a MuJoCo model")
def run(args: Args) -> output.Outcome:
    """Write a fit as C code for a controller, or as a URDF or a MuJoCo model for simulators.

    fit FIT: input  fit to export
    --to {c,urdf,mjcf,usd,isaaclab,ur-friction} required  C99 code, URDF, MuJoCo model,
        USD stage, actuators of Isaac Lab and mjlab, friction of UR's driver
    @FOLDER
    --prefix NAME  prefix of all C names; default: arm
    --payload  a body at the tool is an argument of the C functions
    --into FILE: input  for urdf, mjcf and usd: the file into whose copy the numbers are
        written, such as the export of the other arm of a robot; default: the robot's own
    @EFFECTS_FILE
    """
    for name, given, what in (
        (f"--prefix {args.prefix}:", args.prefix is not None, "a prefix applies"),
        ("--payload", args.payload, "applies"),
    ):
        if given and args.to != "c":
            raise UsageError(f"{name} {what} to C code; expected --to c")
    made = lieid.export(
        lieid.Fit.load(args.fit),
        args.output,
        to=args.to,
        prefix=args.prefix,
        payload=args.payload,
        into=args.into,
        force=args.force,
    )
    written = f"{', '.join(path.name for path in made.files)} written to {args.output}"
    return output.Outcome([written, *(f"  ! {note}" for note in made.notes)])
