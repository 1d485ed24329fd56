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

CRITERIA = ("combined", "condition", "hadamard", "logdet", "a_optimal", "e_optimal")
SOLVERS = ("ipopt", "sqp")
FAMILIES = ("fourier", "modified_fourier", "spline")
INTERRUPTED = 130


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser("excite", help="design an optimal excitation trajectory")
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
        help="write constant-speed runs of these joints instead",
    )  # fmt: skip
    shared_options.add_outputs(parser)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def _add_motion(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("motion")
    group.add_argument(
        "--family", choices=FAMILIES, default="fourier", help="of trajectories; default: fourier"
    )
    for name, kind, default, unit, text in (
        ("--duration", number, 20.0, "S", "of one period, s"),
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
        help="pose at the start and the end, rad; default: middle of the ranges",
    )  # fmt: skip
    group.add_argument(
        "--free-start", action="store_true",
        help="choose the first pose; an approach motion from the start pose is added",
    )  # fmt: skip


def _add_limits(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("limits in addition to those of position and velocity")
    group.add_argument(
        "--acceleration",
        nargs="+",
        type=number,
        metavar="A",
        help="rad/s², one number or one per joint",
    )
    group.add_argument(
        "--torque-fraction", type=number, default=1.0, metavar="F",
        help="fraction of the torque limits that may be used; default: 1",
    )  # fmt: skip
    group.add_argument("--no-torque", action="store_true", help="ignore torque limits")
    group.add_argument(
        "--cartesian-speed", type=number, metavar="V",
        help="speed limit of the tool and the joint centres, m/s",
    )  # fmt: skip
    group.add_argument(
        "--floor", nargs="?", type=number, const=0.0, metavar="Z",
        help="stay above the plane z = Z of the base frame, m; default: 0",
    )  # fmt: skip
    group.add_argument(
        "--wall", nargs=4, type=number, action="append", default=[],
        metavar=("NX", "NY", "NZ", "D"),
        help="stay where n·x ≤ d, base frame, m",
    )  # fmt: skip
    for name, text in (
        ("--workspace-box", "stay inside this box, base frame, m"),
        ("--obstacle", "stay outside of this box, base frame, m"),
    ):  # fmt: skip
        group.add_argument(
            name, nargs=6, type=number, action="append", default=[],
            metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"), help=text,
        )  # fmt: skip
    group.add_argument(
        "--self-collision", nargs="?", type=number, const=0.02, metavar="CLEARANCE",
        help="smallest distance between links, m; default: 0.02",
    )  # fmt: skip
    group.add_argument(
        "--capsules",
        type=InputPath,
        metavar="FILE",
        help="YAML file with capsules around the links; default: fitted to their geometry",
    )


def _add_search(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("search")
    group.add_argument("--solver", choices=SOLVERS, default="ipopt", help="default: ipopt")
    group.add_argument(
        "--starts", type=int, default=4, metavar="N", help="number of random starts; default: 4"
    )
    group.add_argument(
        "--seed", type=seed, default=0, metavar="N", help="of the random starts; default: 0"
    )
    group.add_argument(
        "--max-iterations", type=int, metavar="N", help="of one start; default: no limit"
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
            free_start=args.free_start, acceleration=args.acceleration, family=args.family,
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
    """Return the limits that the options state."""
    from lieid_casadi.excitation import (
        CartesianSpeed,
        Obstacle,
        SelfCollision,
        Torque,
        Wall,
        capsules_of,
        floor,
        load_capsules,
        workspace_box,
    )

    bounded = args.floor is not None or args.wall or args.workspace_box or args.obstacle
    links: Any = ()
    if args.capsules is not None:
        links = load_capsules(args.capsules, robot)
    elif bounded or args.self_collision is not None:
        links = capsules_of(robot)
    limits: list[Limit] = []
    stated = robot.limit("torque")
    if not args.no_torque and robot.has_inertia and (stated == stated).any():
        limits.append(Torque(args.torque_fraction))
    if args.cartesian_speed is not None:
        limits.append(CartesianSpeed(args.cartesian_speed))
    if args.floor is not None:
        limits.append(floor(args.floor, capsules=links))
    limits += [Wall((x, y, z), d, capsules=links) for x, y, z, d in args.wall]
    for corners in args.workspace_box:
        limits += workspace_box(corners[:3], corners[3:], capsules=links)
    limits += [Obstacle(tuple(c[:3]), tuple(c[3:]), capsules=links) for c in args.obstacle]
    if args.self_collision is not None:
        limits.append(SelfCollision(args.self_collision, links))
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
