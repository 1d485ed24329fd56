"""``lieid gains ROBOT --unloaded REC… --loaded REC… --mass KG``: drive gains in N·m/A."""

from __future__ import annotations

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import Args, command
from lieid_casadi.errors import LieidWarning
from lieid_casadi.tables import Table


@command("gains", "drive gains in N·m/A, from currents and a payload of known mass")
def run(args: Args) -> output.Outcome:
    """Determine drive gains in N·m/A from motor currents with and without a known payload.

    @ROBOT
    --unloaded REC …: input required  recordings of currents without the payload
    --loaded REC …: input required  recordings of currents with the payload
    --mass KG: above required  mass of the payload
    @EFFECTS @EFFECTS_FILE @READING @PROCESSING @JSON @THREADS
    """
    robot = inputs.model_of(args).robot
    with output.progress("gains") as report:
        gains = lieid.drive_gains(
            robot,
            inputs.currents_of(args.unloaded, args, robot),
            inputs.currents_of(args.loaded, args, robot),
            mass=args.mass,
            effects=args.effects,
            processing=lieid.Processing(cutoff=args.cutoff),
            progress=report,
        )
    return output.Outcome(shown(gains), json=gains.to_dict())


def shown(gains: lieid.DriveGains) -> tuple[str | Table | LieidWarning, ...]:
    """Return the gains, those not identified, and the option for other commands."""
    from lieid_casadi.gains.identify import gain_table

    return (
        gain_table(gains),
        *(
            f"  * the gain of joint {part.joint + 1} cannot be identified: {part.reason}."
            for part in gains.not_identified
        ),
        *([] if gains.option is None else [f"Option for the other commands:\n{gains.option}"]),
        *gains.warnings,
    )
