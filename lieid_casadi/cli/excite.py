"""``lieid excite ROBOT|FIT -o DIR``: an optimal excitation trajectory within limits."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from lieid_casadi.cli import motion_limits, options, output
from lieid_casadi.cli.option_types import InputPath, number
from lieid_casadi.cli.options import Command, Group, option, removed, several
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    from lieid_casadi.excitation import Excitation
    from lieid_casadi.excitation.limits import Limit
    from lieid_casadi.identification import Fit
    from lieid_casadi.model import Model

BASES = ("fourier", "modified_fourier", "bspline")
INTERRUPTED = 130  # with a trajectory kept


def run(args: argparse.Namespace) -> output.Outcome:
    """Design a trajectory, or friction sweeps."""
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
            acceleration=args.acceleration, margin=args.margin, basis=args.basis,
            duration=args.duration, harmonics=args.harmonics, periods=args.periods,
            samples=args.samples, rate=args.rate, start=args.warm_start,
            starts=args.starts, seed=args.seed, max_iterations=args.max_iterations,
            progress=report,
        )  # fmt: skip
    return output.Outcome(
        lambda: show(excitation, folder),
        json=excitation.to_dict(),
        folder=lambda: excitation.save(folder, force=args.force),
        status=INTERRUPTED if excitation.interrupted else 0,
    )


COMMANDS = (
    Command(
        "excite",
        "design an optimal excitation trajectory",
        "Design a trajectory from which the parameters can be identified, within the limits of "
        "the robot.",
        (
            *options.ROBOT_OR_FIT,
            *options.output_folder(),
            options.effects(),
            options.EFFECTS_FILE,
            option(
                "--criterion NAME",
                "what is minimized: condition number with a bound on −log det of the information "
                "matrix (combined) or without (condition), 1/product of the column norms "
                "(hadamard), −log det (logdet)",
                default="combined",
            ),
            option("--inertial-only", "leave effects out of the regressor"),
            Group(
                "motion",
                (
                    option(
                        "--basis",
                        "functions that trajectories are composed of",
                        default="fourier",
                        choices=BASES,
                    ),
                    removed("--family", "use --basis; spline is bspline"),
                    option("--duration S", "duration of one period, s", number, 20.0),
                    option("--harmonics N", "harmonics of each joint", int, 5),
                    option("--periods N", "number of periods", int, 1),
                    option("--samples N", "samples of one period in the criterion", int, 100),
                    option("--rate HZ", "sampling rate of the files, Hz", number, 1000.0),
                    motion_limits.START_POSE,
                ),
            ),
            motion_limits.LIMITS,
            Group(
                "search",
                (
                    removed("--solver", "Ipopt is the only solver"),
                    option(
                        "--warm-start FILE",
                        "trajectory (CSV with t, q1 … qn) of one period from which the first "
                        "search starts",
                        InputPath,
                    ),
                    option("--starts N", "number of random starts", int, 4),
                    options.random_seed("seed of the random starts"),
                    option(
                        "--max-iterations N",
                        "largest number of iterations of one start; default: no limit",
                        int,
                    ),
                ),
            ),
            several(
                "--friction-sweep JOINT",
                "write runs of these joints at constant speeds instead",
                int,
            ),
            options.JSON,
            options.THREADS,
        ),
        run,
    ),
)


def _sweep(
    args: argparse.Namespace, arm: Model | Fit, limits: list[Limit], folder: Path
) -> output.Outcome:
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
    contents = {name: data for sweep in sweeps for name, data in sweep.files().items()}

    def show() -> None:
        for sweep in sweeps:
            count, left_out = len(sweep.parts) // 2, len(sweep.left_out)
            output.say(
                f"Joint {sweep.joint + 1}: {count} speeds forward and back, "
                f"{sweep.motion.t[-1]:.0f} s; {left_out} left out. Files in {folder}."
            )
        output.say(f"Checked: {'; '.join(sweeps[0].checked)}.")
        output.say(f"Not checked: {'; '.join(sweeps[0].unchecked)}.")

    return output.Outcome(
        show,
        json={"sweeps": [sweep.to_dict() for sweep in sweeps]},
        folder=lambda: write_folder(folder, contents, force=args.force),
    )


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
