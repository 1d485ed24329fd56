"""``lieid friction ROBOT REC… --joint J``: the friction curve of one joint and its fit."""

from __future__ import annotations

from typing import Any

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import Args, command
from lieid_casadi.errors import UsageError


@command("friction", "friction of one joint from its motion in both directions")
def run(args: Args) -> output.Outcome:
    """Determine the friction of one joint from its motion in both directions, and fit a model.

    @ROBOT
    recordings REC …: input  recordings in which the joint moves in both directions
    --joint J: int required  number of the joint, from 1
    --effects A,B,…  friction model: effects of speed and load; default:
        coulomb,viscous,stribeck, and load_friction where the load varies
    --fit FIT: input  fit of the whole arm, whose rigid torque is used, also as the load
    @RECORDING
    --cutoff HZ: number  cut-off frequency of the low-pass filter
    @JSON
    """
    from lieid_casadi.friction_curves import fit_friction, friction_curve
    from lieid_casadi.friction_curves.curve import curve_table
    from lieid_casadi.friction_curves.friction_fit import parameter_table

    robot = inputs.robot_of(args)
    if not 1 <= args.joint <= robot.n:
        raise UsageError(f"--joint {args.joint}: {robot.name} has joints 1 to {robot.n}")
    whole = None if args.fit is None else _whole(args.fit, robot)
    curve = friction_curve(
        whole or robot,
        inputs.recordings_of(args.recordings, args, robot),
        args.joint - 1,
        processing=lieid.Processing(cutoff=args.cutoff),
    )
    fit = fit_friction(curve, args.effects)
    return output.Outcome(
        (curve_table(curve), parameter_table(fit), *curve.warnings, *fit.warnings),
        json=content(fit),
    )


def content(fit: lieid.FrictionFit) -> dict[str, Any]:
    """Return the JSON of ``lieid friction``."""
    curve, own = fit.curve.to_dict(), fit.to_dict()
    warnings = [*curve.pop("warnings"), *own.pop("warnings")]
    return {"joint": curve["joint"], "curve": curve, "fit": own, "warnings": warnings}


def _whole(path: str, robot: lieid.Robot) -> lieid.Fit:
    """Return a fit of the whole arm."""
    fit = lieid.Fit.load(path)
    if fit.model.n != robot.n:
        raise UsageError(f"{path}: a fit of {fit.model.n} joints; {robot.name} has {robot.n}")
    return fit
