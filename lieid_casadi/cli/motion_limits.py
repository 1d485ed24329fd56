"""Options of the commands that design motions: limits, and the arm that they hold for."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn

from lieid_casadi.cli import effects_file, shared_options
from lieid_casadi.cli.option_types import InputPath, number
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.excitation.limits import Limit
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model
    from lieid_casadi.robot import Robot

MARGIN, TOOL_SPEED, FLOOR, CLEARANCE = 0.8, 1.5, 0.0, 0.02  # of `default_limits`


def add_limits(parser: argparse.ArgumentParser) -> None:
    """Add the options of `limits_of`, --acceleration and --margin."""
    group = parser.add_argument_group("limits in addition to those of position and velocity")
    group.add_argument(
        "--acceleration",
        nargs="+",
        type=number,
        metavar="A",
        help="acceleration limits, rad/s², one or one per joint; default: the robot's, or 3",
    )
    group.add_argument(
        "--jerk", nargs="+", type=number, metavar="J",
        help="jerk limits, rad/s³, one or one per joint; default: none",
    )  # fmt: skip
    group.add_argument(
        "--margin", type=number, default=MARGIN, metavar="F",
        help="fraction of the velocity and torque limits that is used; default: 0.8",
    )  # fmt: skip
    group.add_argument(
        "--torque-fraction",
        type=replaced("use --margin, for velocity and torque limits"),
        help=argparse.SUPPRESS,
    )
    group.add_argument("--no-torque", action="store_true", help="do not check torque limits")
    _add_workspace(group)


def _add_workspace(group: argparse._ArgumentGroup) -> None:
    """Add the limits that the links and the tool keep."""
    group.add_argument(
        "--cartesian-speed", type=number, default=TOOL_SPEED, metavar="M/S",
        help="highest speed of the tool and of the joint centres, m/s; default: 1.5",
    )  # fmt: skip
    group.add_argument(
        "--floor", nargs="?", type=_height, default=FLOOR, const=FLOOR, metavar="Z",
        help="height of the floor in the base frame, m, or none; default: 0",
    )  # fmt: skip
    group.add_argument(
        "--unchecked-workspace", action="store_true",
        help="do not check floor, self-collision and tool speed",
    )  # fmt: skip
    group.add_argument(
        "--wall", nargs=4, type=number, action="append", default=[],
        metavar=("NX", "NY", "NZ", "D"),
        help="keep the arm where n·x ≤ d, base frame, m",
    )  # fmt: skip
    for name, text in (
        ("--workspace-box", "keep the arm inside this box, base frame, m"),
        ("--obstacle", "keep the arm outside this box, base frame, m"),
    ):  # fmt: skip
        group.add_argument(
            name, nargs=6, type=number, action="append", default=[],
            metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"), help=text,
        )  # fmt: skip
    group.add_argument(
        "--self-collision", nargs="?", type=number, default=CLEARANCE,
        const=CLEARANCE, metavar="M",
        help="least distance between links, m; default: 0.02",
    )  # fmt: skip
    group.add_argument(
        "--capsules",
        type=InputPath,
        metavar="FILE",
        help="YAML file with capsules around the links; default: fitted to their geometry",
    )


def _height(text: str) -> float | None:
    """Return a height in m, or None for ``none``."""
    return None if text == "none" else number(text)


def replaced(advice: str) -> Callable[[str], NoReturn]:
    """Return the type of an option that was removed: it refuses every value with advice."""

    def refuse(text: str) -> NoReturn:
        raise argparse.ArgumentTypeError(f"{text}: removed; {advice}")

    return refuse


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
    if not args.robot.endswith(".json"):
        model = shared_options.model_of(args)
        return model, model.robot
    from lieid_casadi.identification import Fit

    given = {
        "--effects": args.effects != shared_options.DEFAULT_EFFECTS,
        "--tip": args.tip is not None,
        "--lock": bool(args.lock),
    }
    for name, is_given in given.items():
        if is_given:
            raise UsageError(f"{name}: a fit ({args.robot}) has its own robot and effects")
    effects_file.load(args.effects_file)
    fit = Fit.load(args.robot)
    return fit, fit.model.robot
