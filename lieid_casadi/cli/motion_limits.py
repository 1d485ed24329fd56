"""Limits of designed motions, as options, and the arm that they hold for."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import inputs
from lieid_casadi.cli.options import given
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.excitation.limits import Limit
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model
    from lieid_casadi.robot import Robot


def limits_of(args: argparse.Namespace, robot: Robot) -> list[Limit]:
    """Return the default limits with the changes that the options specify."""
    from lieid_casadi.excitation import (
        Obstacle,
        Torque,
        Wall,
        capsules_of,
        default_limits,
        jerk_limit,
        load_capsules,
        workspace_box,
    )

    workspace = not args.unchecked_workspace
    links: Any = ()
    if args.capsules is not None:
        links = load_capsules(args.capsules, robot)
    elif workspace or args.wall or args.workspace_box or args.obstacle:
        links = capsules_of(robot)
    defaults = default_limits(
        robot,
        margin=args.margin,
        capsules=links,
        floor_height=args.floor if workspace else None,
        cartesian_speed=args.cartesian_speed if workspace else None,
        clearance=args.self_collision if workspace else None,
    )
    limits = [x for x in defaults if not (args.no_torque and isinstance(x, Torque))]
    if args.jerk:
        limits.append(jerk_limit(args.jerk if len(args.jerk) > 1 else args.jerk[0]))
    limits += [Wall((x, y, z), d, capsules=links) for x, y, z, d in args.wall]
    for corners in args.workspace_box:
        limits += workspace_box(corners[:3], corners[3:], capsules=links)
    limits += [Obstacle(tuple(c[:3]), tuple(c[3:]), capsules=links) for c in args.obstacle]
    return limits


def arm_of(args: argparse.Namespace) -> tuple[Model | Fit, Robot]:
    """Return the fit that ROBOT|FIT names, or the model of a robot with --effects; its robot."""
    if not inputs.is_fit(args):
        model = inputs.model_of(args)
        return model, model.robot
    from lieid_casadi.identification import Fit

    if names := given("@EFFECTS @TIP_AND_LOCK", args):
        raise UsageError(f"{next(iter(names))}: a fit ({args.robot}) has its own robot and effects")
    fit = Fit.load(args.robot)
    return fit, fit.model.robot
