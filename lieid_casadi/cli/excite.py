"""``lieid excite ROBOT|FIT -o DIR``: an optimal excitation trajectory within limits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import Args, command
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    from lieid_casadi.excitation.limits import Limit

INTERRUPTED = 130  # with a trajectory kept


@command("excite", "design an optimal excitation trajectory")
def run(args: Args) -> output.Outcome:
    """Design a trajectory from which the parameters can be identified, within the robot's limits.

    @ROBOT_OR_FIT @FOLDER @EFFECTS @EFFECTS_FILE
    --criterion NAME = combined  what is minimized: condition number with a bound on −log
        det of the information matrix (combined) or without (condition), 1/product of the
        column norms (hadamard), −log det (logdet)
    --inertial-only  leave effects out of the regressor
    @LIMITS
    --friction-sweep JOINT …: int  write runs of these joints at constant speeds instead
    @JSON @THREADS
    == motion
    --duration S: number = 20  duration, s
    --harmonics N: int = 5  harmonics of each joint
    --samples N: int = 100  samples in the criterion
    --rate HZ: number = 1000  sampling rate of the files, Hz
    --start-pose Q …: number  pose at the start and the end, rad; default: a pose found
        within all limits
    == search
    --starts N: int = 4  number of random starts
    --seed N: seed = 0  seed of the random starts
    --max-iterations N: int  largest number of iterations of one start; default: no
        limit
    """
    folder = Path(args.output)
    arm, robot = inputs.arm_of(args)
    limits = inputs.limits_of(args, robot)
    if args.friction_sweep:
        return _sweep(args, arm, limits, folder)
    with output.progress("excite") as report:
        excitation = lieid.excite(
            arm,
            criterion=args.criterion, inertial_only=args.inertial_only,
            limits=limits, start_pose=args.start_pose or None,
            acceleration=args.acceleration or None, margin=args.margin,
            duration=args.duration, harmonics=args.harmonics,
            samples=args.samples, rate=args.rate,
            starts=args.starts, seed=args.seed, max_iterations=args.max_iterations,
            progress=report,
        )  # fmt: skip
    starts = make_table(
        "Starts",
        ["start", "condition number", "−log det", "s"],
        [
            (f"seed {s.seed}", s.condition_number, s.neg_log_det, s.seconds)
            for s in excitation.starts
        ],
    )
    seconds = (
        f"Built in {excitation.build_seconds:.2g} s, solved in {excitation.solve_seconds:.2g} s."
    )
    return output.Outcome(
        (excitation.summary(), starts, f"{seconds} Files in {folder}."),
        json=excitation.to_dict(),
        folder=lambda: excitation.save(folder, force=args.force),
        status=INTERRUPTED if excitation.interrupted else 0,
    )


def _sweep(
    args: Args, arm: lieid.Model | lieid.Fit, limits: list[Limit], folder: Path
) -> output.Outcome:
    """Design runs of single joints at constant speeds."""
    from lieid_casadi.excitation import friction_sweep
    from lieid_casadi.output_folder import write_folder

    sweeps = [
        friction_sweep(
            arm,
            joint - 1,
            start_pose=args.start_pose or None,
            acceleration=args.acceleration or None,
            margin=args.margin,
            limits=limits,
            rate=min(args.rate, 200.0),
        )
        for joint in args.friction_sweep
    ]
    contents = {name: data for sweep in sweeps for name, data in sweep.files().items()}
    shown = [
        f"Joint {sweep.joint + 1}: {len(sweep.parts) // 2} speeds forward and back, "
        f"{sweep.motion.t[-1]:.0f} s; {len(sweep.left_out)} left out. Files in {folder}."
        for sweep in sweeps
    ]
    shown.append(f"Checked: {'; '.join(sweeps[0].checked)}.")
    shown.append(f"Not checked: {'; '.join(sweeps[0].unchecked)}.")
    return output.Outcome(
        shown,
        json={"sweeps": [sweep.to_dict() for sweep in sweeps]},
        folder=lambda: write_folder(folder, contents, force=args.force),
    )
