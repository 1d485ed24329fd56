"""``lieid discriminate FIT EFFECT EFFECT… -o DIR``: the trajectory that separates rival effects."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from lieid_casadi.cli import inputs, motion_limits, options, output
from lieid_casadi.cli.excite import INTERRUPTED
from lieid_casadi.cli.option_types import InputPath, number
from lieid_casadi.cli.options import Command, option, several
from lieid_casadi.errors import UsageError
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    from lieid_casadi.discrimination import Discrimination


def run(args: argparse.Namespace) -> output.Outcome:
    """Design the trajectory."""
    from lieid_casadi.discrimination import discriminate

    folder = Path(args.output)
    sizes = sizes_of(args.size)
    fit, recordings = inputs.fit_and_recordings(args)
    with output.progress("discriminate") as report:
        result = discriminate(
            fit, args.effects, sizes=sizes, recordings=recordings,
            level=args.level, duration=args.duration, harmonics=args.harmonics,
            start_pose=args.start_pose, acceleration=args.acceleration, margin=args.margin,
            limits=motion_limits.limits_of(args, fit.model.robot), rate=args.rate,
            evaluations=args.evaluations, seed=args.seed, progress=report,
        )  # fmt: skip
    return output.Outcome(
        lambda: show(result, folder),
        json=result.to_dict(),
        folder=lambda: result.save(folder, force=args.force),
        status=INTERRUPTED if result.interrupted else 0,
    )


COMMANDS = (
    Command(
        "discriminate",
        "design the trajectory that separates rival effects",
        "Design the trajectory that separates rival effects, and state how long it must be.",
        (
            option("fit FIT", "fit of the arm", InputPath),
            several("effects EFFECT", "rival effects, such as stribeck:4; at least two", None),
            *options.output_folder(),
            option(
                "--size EFFECT=V1[,V2…]",
                "coefficients and shape parameters of an effect; default: fitted, or noise level",
                default=[],
                action="append",
            ),
            several(
                "--recordings REC", "recordings from which the spectrum of the noise is estimated"
            ),
            option("--level P", "confidence level", number, 0.95),
            option("--duration S", "duration of one period, s", number, 10.0),
            option("--harmonics N", "harmonics of each joint", int, 5),
            motion_limits.START_POSE,
            motion_limits.LIMITS,
            option("--rate HZ", "sampling rate of the files, Hz", number, 1000.0),
            option("--evaluations N", "evaluations of the criterion in the search", int, 1500),
            options.random_seed("seed of the search"),
            *options.RECORDING,
            options.JSON,
        ),
        run,
    ),
)


def sizes_of(texts: list[str]) -> dict[str, list[float]]:
    """Return the sizes that ``--size EFFECT=V1,V2`` states."""
    sizes = {}
    for text in texts:
        label, _, numbers = text.partition("=")
        try:
            sizes[label] = [float(number) for number in numbers.split(",")]
        except ValueError:
            raise UsageError(
                f"--size {text}: expected EFFECT=V1[,V2…], as stribeck:4=0.5"
            ) from None
    return sizes


def show(result: Discrimination, folder: Path) -> None:
    """Print the result."""
    output.say(result.summary())
    output.show(
        make_table(
            "Residual if one effect is true and the other is fitted",
            ["true", "fitted", "residual, % of the effect", "χ² per period", "χ² required"],
            [
                [p.true, p.rival, 100.0 * p.remaining, p.noncentrality, p.needed]
                if p.separable
                else [p.true, p.rival, "can represent it", None, None]
                for p in result.pairs
            ],
        )
    )
    sizes = [f"{label}: {', '.join(f'{x:.4g}' for x in v)}" for label, v in result.sizes.items()]
    output.say(f"Sizes: {'; '.join(sizes)}. Designed in {result.solve_seconds:.2g} s.")
    output.say(f"Files in {folder}; trajectory.csv is one period of the motion.")
