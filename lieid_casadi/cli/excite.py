"""``lieid excite ROBOT|FIT -o DIR``: an optimal excitation trajectory within limits."""

from __future__ import annotations

import argparse
from pathlib import Path

from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import command
from lieid_casadi.tables import make_table

INTERRUPTED = 130  # with a trajectory kept


@command("excite", "design an optimal excitation trajectory")
def run(args: argparse.Namespace) -> output.Outcome:
    """Design a trajectory from which the parameters can be identified, within the robot's limits.

    @ROBOT_OR_FIT @FOLDER @EFFECTS @EFFECTS_FILE
    --criterion NAME = combined  what is minimized: condition number with a bound on −log
        det of the information matrix (combined) or without (condition), 1/product of the
        column norms (hadamard), −log det (logdet)
    --inertial-only  leave effects out of the regressor
    @LIMITS
    @JSON @THREADS
    == motion
    --duration S: number = 20  duration of one period, s
    --harmonics N: int = 5  harmonics of each joint
    --periods N: int = 1  number of periods
    --samples N: int = 100  samples of one period in the criterion
    --rate HZ: number = 1000  sampling rate of the files, Hz
    --start-pose Q …: number  pose at the start and the end, rad; default: a pose found
        within all limits
    == search
    --starts N: int = 4  number of random starts
    --seed N: seed = 0  seed of the random starts
    --max-iterations N: int  largest number of iterations of one start; default: no
        limit
    """
    from lieid_casadi.excitation import excite

    folder = Path(args.output)
    arm, robot = inputs.arm_of(args)
    with output.progress("excite") as report:
        excitation = excite(
            arm,
            criterion=args.criterion, inertial_only=args.inertial_only,
            limits=inputs.limits_of(args, robot), start_pose=args.start_pose or None,
            acceleration=args.acceleration or None, margin=args.margin,
            duration=args.duration, harmonics=args.harmonics, periods=args.periods,
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
