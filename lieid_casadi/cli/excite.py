"""``lieid excite ROBOT|FIT -o DIR``: an optimal excitation trajectory within limits."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import motion_limits, output, shared_options
from lieid_casadi.cli.motion_limits import replaced
from lieid_casadi.cli.option_types import InputPath, number, seed
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    from lieid_casadi.excitation import Excitation
    from lieid_casadi.excitation.limits import Limit
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model

CRITERIA = ("combined", "condition", "hadamard", "logdet", "a_optimal", "e_optimal")
BASES = ("fourier", "modified_fourier", "bspline")
INTERRUPTED = 130


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "excite",
        help="design an optimal excitation trajectory",
        description="Design a trajectory from which the parameters can be identified, within the "
        "limits of the robot.",
    )
    shared_options.add_robot(parser, fit=True)
    shared_options.add_output_folder(parser)
    shared_options.add_effects(parser)
    parser.add_argument(
        "--criterion", choices=CRITERIA, default="combined",
        help="what is minimized: condition number, with a bound on −log det (combined) or without, "
        "1/product of the column norms (hadamard), −log det of the information matrix, sum "
        "(a_optimal) or largest axis (e_optimal) of the covariance; default: combined",
    )  # fmt: skip
    parser.add_argument(
        "--inertial-only", action="store_true", help="leave effects out of the regressor"
    )
    parser.add_argument(
        "--scaling", choices=("si", "units", "prior", "unit_norm"), default="si",
        help="scaling of the columns in the criterion: none (si), by mass and length of the arm "
        "(units), by the stated parameters (prior), or to norm 1 (unit_norm); default: si",
    )  # fmt: skip
    _add_motion(parser)
    motion_limits.add_limits(parser)
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
        "--basis", choices=BASES, default="fourier",
        help="functions that trajectories are composed of; default: fourier",
    )  # fmt: skip
    group.add_argument(
        "--family", type=replaced("use --basis; spline is bspline"), help=argparse.SUPPRESS
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


def _add_search(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("search")
    group.add_argument(
        "--solver", type=replaced("Ipopt is the only solver"), help=argparse.SUPPRESS
    )
    group.add_argument(
        "--warm-start", type=InputPath, metavar="FILE",
        help="trajectory (CSV with t, q1 … qn) of one period from which the first search starts",
    )  # fmt: skip
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
    arm, robot = motion_limits.arm_of(args)
    limits = motion_limits.limits_of(args, robot)
    if args.friction_sweep:
        return _sweep(args, arm, limits, folder)
    with output.progress("excite") as report:
        excitation = excite(
            arm,
            criterion=args.criterion, inertial_only=args.inertial_only,
            limits=limits, start_pose=args.start_pose,
            free_start=args.free_start, acceleration=args.acceleration, margin=args.margin,
            basis=args.basis,
            duration=args.duration, harmonics=args.harmonics, periods=args.periods,
            samples=args.samples, rate=args.rate, scaling=args.scaling, start=args.warm_start,
            starts=args.starts, seed=args.seed, max_iterations=args.max_iterations,
            progress=report,
        )  # fmt: skip
    files = output.Files()
    files.add_json(args.json, excitation.to_dict())
    excitation.save(folder, force=args.force)
    files.write()
    show(excitation, folder)
    return INTERRUPTED if excitation.interrupted else 0


def _sweep(args: argparse.Namespace, arm: Model | Fit, limits: list[Limit], folder: Path) -> int:
    from lieid_casadi.excitation import friction_sweep
    from lieid_casadi.output_folder import write_folder

    sweeps = [
        friction_sweep(
            arm,
            joint - 1,
            start_pose=args.start_pose,
            acceleration=args.acceleration,
            margin=args.margin,
            limits=limits,
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
    output.say(f"Checked: {'; '.join(sweeps[0].checked)}.")
    output.say(f"Not checked: {'; '.join(sweeps[0].unchecked)}.")
    return 0


def show(excitation: Excitation, folder: Path) -> None:
    """Print the result."""
    output.say(excitation.summary())
    rows = [
        [
            "file" if s.seed is None else f"seed {s.seed}",
            s.condition_number,
            s.neg_log_det,
            s.seconds,
        ]
        for s in excitation.starts
    ]
    output.show(make_table("Starts", ["start", "condition number", "−log det", "s"], rows))
    output.say(
        f"Built in {excitation.build_seconds:.2g} s, solved in {excitation.solve_seconds:.2g} s. "
        f"Files in {folder}."
    )
