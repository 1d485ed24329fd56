"""``lieid excite ROBOT -o DIR``: an optimal excitation trajectory within limits."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import output, shared_options
from lieid_casadi.cli.option_types import InputPath, number, seed
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    from lieid_casadi.excitation import Excitation
    from lieid_casadi.excitation.limits.symbolic_limits import Limit
    from lieid_casadi.model import Model
    from lieid_casadi.robot import Robot

MARGIN, TOOL_SPEED, FLOOR, CLEARANCE = 0.8, 1.5, 0.0, 0.02  # of `default_limits`
CRITERIA = ("combined", "condition", "hadamard", "logdet", "a_optimal", "e_optimal")
SOLVERS = ("ipopt", "sqp")
FAMILIES = ("fourier", "modified_fourier", "spline")
INTERRUPTED = 130


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "excite",
        help="design an optimal excitation trajectory",
        description="Design a trajectory from which the parameters can be identified, within the "
        "limits of the robot.",
    )
    shared_options.add_robot(parser)
    shared_options.add_output_folder(parser)
    shared_options.add_effects(parser)
    parser.add_argument(
        "--criterion", choices=CRITERIA, default="combined",
        help="criterion of the regressor that is optimized; default: combined",
    )  # fmt: skip
    parser.add_argument(
        "--inertial-only", action="store_true", help="leave effects out of the regressor"
    )
    parser.add_argument(
        "--scaling", choices=("si", "units", "prior", "unit_norm"), default="si",
        help="scaling of the columns in the criterion; default: si",
    )  # fmt: skip
    _add_motion(parser)
    _add_limits(parser)
    _add_search(parser)
    parser.add_argument(
        "--friction-sweep", nargs="+", type=int, metavar="JOINT",
        help="write runs of these joints at constant speeds instead",
    )  # fmt: skip
    shared_options.add_outputs(parser)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def _add_motion(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("motion")
    group.add_argument(
        "--family",
        choices=FAMILIES,
        default="fourier",
        help="family of trajectories; default: fourier",
    )
    for name, kind, default, unit, text in (
        ("--duration", number, 20.0, "S", "duration of one period, s"),
        ("--harmonics", int, 5, "N", "harmonics of each joint"),
        ("--periods", int, 1, "N", "number of periods"),
        ("--samples", int, 100, "N", "samples of one period in the criterion"),
        ("--rate", number, 1000.0, "HZ", "sampling rate of the files, Hz"),
    ):
        group.add_argument(
            name, type=kind, default=default, metavar=unit, help=f"{text}; default: {default:g}"
        )
    group.add_argument(
        "--start-pose", nargs="+", type=number, metavar="Q",
        help="pose at the start and the end, rad; default: a pose found within all limits",
    )  # fmt: skip
    group.add_argument(
        "--free-start", action="store_true",
        help="optimize the first pose, too; an approach motion from the start pose is added",
    )  # fmt: skip


def _add_limits(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("limits in addition to those of position and velocity")
    group.add_argument(
        "--acceleration",
        nargs="+",
        type=number,
        metavar="A",
        help="acceleration limits, rad/s², one or one per joint; default: the robot's, or 3",
    )
    group.add_argument(
        "--margin", type=number, default=MARGIN, metavar="F",
        help="fraction of the velocity and torque limits that is used; default: 0.8",
    )  # fmt: skip
    group.add_argument("--torque-fraction", type=_replaced_by_margin, help=argparse.SUPPRESS)
    group.add_argument("--no-torque", action="store_true", help="do not check torque limits")
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


def _replaced_by_margin(text: str) -> float:
    raise argparse.ArgumentTypeError(f"{text}: use --margin, for velocity and torque limits")


def _add_search(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("search")
    group.add_argument(
        "--solver", choices=SOLVERS, default="ipopt", help="optimization method; default: ipopt"
    )
    group.add_argument(
        "--starts", type=int, default=4, metavar="N", help="number of random starts; default: 4"
    )
    group.add_argument(
        "--seed", type=seed, default=0, metavar="N", help="seed of the random starts; default: 0"
    )
    group.add_argument(
        "--max-iterations",
        type=int,
        metavar="N",
        help="largest number of iterations of one start; default: no limit",
    )


def run(args: argparse.Namespace) -> int:
    """Design, write and print; return 130 if interrupted with a trajectory kept."""
    from lieid_casadi.excitation import excite

    folder = Path(args.output)
    model = shared_options.model_of(args)
    if args.friction_sweep:
        return _sweep(args, model, folder)
    with output.progress("excite") as report:
        excitation = excite(
            model,
            criterion=args.criterion, inertial_only=args.inertial_only,
            constraints=limits_of(args, model.robot), start_pose=args.start_pose,
            free_start=args.free_start, acceleration=args.acceleration, margin=args.margin,
            family=args.family,
            duration=args.duration, harmonics=args.harmonics, periods=args.periods,
            samples=args.samples, rate=args.rate, scaling=args.scaling, solver=args.solver,
            starts=args.starts, seed=args.seed, max_iterations=args.max_iterations,
            progress=report,
        )  # fmt: skip
    files = output.Files()
    files.add_json(args.json, excitation.to_dict())
    excitation.save(folder, force=args.force)
    files.write()
    show(excitation, folder)
    return INTERRUPTED if excitation.interrupted else 0


def limits_of(args: argparse.Namespace, robot: Robot) -> list[Limit]:
    """Return the default limits with the changes that the options specify."""
    from lieid_casadi.excitation import (
        Obstacle,
        Torque,
        Wall,
        capsules_of,
        default_limits,
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
    limits += [Wall((x, y, z), d, capsules=links) for x, y, z, d in args.wall]
    for corners in args.workspace_box:
        limits += workspace_box(corners[:3], corners[3:], capsules=links)
    limits += [Obstacle(tuple(c[:3]), tuple(c[3:]), capsules=links) for c in args.obstacle]
    return limits


def _sweep(args: argparse.Namespace, model: Model, folder: Path) -> int:
    from lieid_casadi.excitation import friction_sweep
    from lieid_casadi.output_folder import write_folder

    sweeps = [
        friction_sweep(
            model,
            joint - 1,
            start_pose=args.start_pose,
            acceleration=args.acceleration,
            margin=args.margin,
            constraints=limits_of(args, model.robot),
            rate=min(args.rate, 200.0),
        )
        for joint in args.friction_sweep
    ]
    files = output.Files()
    files.add_json(args.json, {"sweeps": [sweep.to_dict() for sweep in sweeps]})
    contents = {name: data for sweep in sweeps for name, data in sweep.files().items()}
    write_folder(folder, contents, force=args.force)
    files.write()
    for sweep in sweeps:
        count, left_out = len(sweep.parts) // 2, len(sweep.left_out)
        output.say(
            f"Joint {sweep.joint + 1}: {count} speeds forward and back, "
            f"{sweep.motion.t[-1]:.0f} s; {left_out} left out. Files in {folder}."
        )
    return 0


def show(excitation: Excitation, folder: Path) -> None:
    """Print the result."""
    output.say(excitation.summary())
    rows = [
        [f"seed {s.seed}", s.condition_number, s.neg_log_det, s.seconds] for s in excitation.starts
    ]
    output.show(make_table("Random starts", ["start", "condition number", "−log det", "s"], rows))
    output.say(
        f"Built in {excitation.build_seconds:.2g} s, solved in {excitation.solve_seconds:.2g} s. "
        f"Files in {folder}."
    )
