"""Limits of designed motions, as options, and the arm that they hold for."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import inputs
from lieid_casadi.cli.option_types import InputPath, number
from lieid_casadi.cli.options import DEFAULT_EFFECTS, Group, option, removed, several
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.excitation.limits import Limit
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model
    from lieid_casadi.robot import Robot

MARGIN, TOOL_SPEED, FLOOR, CLEARANCE = 0.8, 1.5, 0.0, 0.02  # of `default_limits`
BOX = ("X0", "Y0", "Z0", "X1", "Y1", "Z1")


def _height(text: str) -> float | None:
    """Return a height in m, or None for ``none``."""
    return None if text == "none" else number(text)


START_POSE = option(
    "--start-pose Q",
    "pose at the start and the end, rad; default: a pose found within all limits",
    number,
    nargs="+",
)
LIMITS = Group(
    "limits in addition to those of position and velocity",
    (
        option(
            "--acceleration A",
            "acceleration limits, rad/s², one or one per joint; default: the robot's, or 3",
            number,
            nargs="+",
        ),
        option(
            "--jerk J",
            "jerk limits, rad/s³, one or one per joint; default: none",
            number,
            nargs="+",
        ),
        option(
            "--margin F", "fraction of the velocity and torque limits that is used", number, MARGIN
        ),
        removed("--torque-fraction", "use --margin, for velocity and torque limits"),
        option("--no-torque", "do not check torque limits"),
        option(
            "--cartesian-speed M/S",
            "highest speed of the tool and of the joint centres, m/s",
            number,
            TOOL_SPEED,
        ),
        option(
            "--floor Z",
            "height of the floor in the base frame, m, or none",
            _height,
            FLOOR,
            nargs="?",
            const=FLOOR,
        ),
        option("--unchecked-workspace", "do not check floor, self-collision and tool speed"),
        several(
            "--wall",
            "keep the arm where n·x ≤ d, base frame, m",
            number,
            nargs=4,
            action="append",
            metavar=("NX", "NY", "NZ", "D"),
        ),
        *(
            several(name, text, number, nargs=6, action="append", metavar=BOX)
            for name, text in (
                ("--workspace-box", "keep the arm inside this box, base frame, m"),
                ("--obstacle", "keep the arm outside this box, base frame, m"),
            )
        ),
        option(
            "--self-collision M",
            "least distance between links, m",
            number,
            CLEARANCE,
            nargs="?",
            const=CLEARANCE,
        ),
        option(
            "--capsules FILE",
            "YAML file with capsules around the links; default: fitted to their geometry",
            InputPath,
        ),
    ),
)


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
    limits: list[Limit] = [
        limit
        for limit in default_limits(
            robot, margin=args.margin, capsules=links,
            floor_height=args.floor if workspace else None,
            cartesian_speed=args.cartesian_speed if workspace else None,
            clearance=args.self_collision if workspace else None,
        )
        if not (args.no_torque and isinstance(limit, Torque))
    ]  # fmt: skip
    if args.jerk is not None:
        limits.append(jerk_limit(args.jerk if len(args.jerk) > 1 else args.jerk[0]))
    limits += [Wall((x, y, z), d, capsules=links) for x, y, z, d in args.wall]
    for corners in args.workspace_box:
        limits += workspace_box(corners[:3], corners[3:], capsules=links)
    limits += [Obstacle(tuple(c[:3]), tuple(c[3:]), capsules=links) for c in args.obstacle]
    return limits


def arm_of(args: argparse.Namespace) -> tuple[Model | Fit, Robot]:
    """Return the fit that ROBOT|FIT names, or the model of a robot with --effects; its robot.

    Raises
    ------
    UsageError
        An option that a fit does not take.
    """
    if not inputs.is_fit(args):
        model = inputs.model_of(args)
        return model, model.robot
    from lieid_casadi.identification import Fit

    given = {
        "--effects": args.effects != DEFAULT_EFFECTS,
        "--tip": args.tip is not None,
        "--lock": bool(args.lock),
    }
    for name, is_given in given.items():
        if is_given:
            raise UsageError(f"{name}: a fit ({args.robot}) has its own robot and effects")
    fit = Fit.load(args.robot)
    return fit, fit.model.robot
