"""``lieid discriminate FIT EFFECT EFFECT… -o DIR``: the trajectory that separates rival effects."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import effects_file, motion_limits, output, shared_options
from lieid_casadi.cli.excite import INTERRUPTED
from lieid_casadi.cli.option_types import InputPath, number, seed
from lieid_casadi.errors import UsageError
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    from lieid_casadi.discrimination import Discrimination


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "discriminate",
        help="design the trajectory that separates rival effects",
        description="Design the trajectory that separates rival effects, and state how long it "
        "must be.",
    )
    parser.add_argument("fit", type=InputPath, metavar="FIT", help="fit of the arm")
    parser.add_argument(
        "effects",
        nargs="+",
        metavar="EFFECT",
        help="rival effects, such as stribeck:4; at least two",
    )
    shared_options.add_output_folder(parser)
    parser.add_argument(
        "--size", action="append", default=[], metavar="EFFECT=V1[,V2…]",
        help="coefficients and shape parameters of an effect; default: fitted, or noise level",
    )  # fmt: skip
    parser.add_argument(
        "--recordings", nargs="+", type=InputPath, default=[], metavar="REC",
        help="recordings from which the spectrum of the noise is estimated",
    )  # fmt: skip
    parser.add_argument(
        "--level", type=number, default=0.95, metavar="P", help="confidence level; default: 0.95"
    )
    _add_motion(parser)
    motion_limits.add_limits(parser)
    _add_search(parser)
    effects_file.add_option(parser)
    shared_options.add_recording_options(parser)
    shared_options.add_outputs(parser)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def _add_motion(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--duration",
        type=number,
        default=10.0,
        metavar="S",
        help="duration of one period, s; default: 10",
    )
    parser.add_argument(
        "--harmonics", type=int, default=5, metavar="N", help="harmonics of each joint; default: 5"
    )
    parser.add_argument(
        "--start-pose", type=number, nargs="+", metavar="Q",
        help="pose at the start and the end, rad; default: a pose found within all limits",
    )  # fmt: skip


def _add_search(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rate",
        type=number,
        default=1000.0,
        metavar="HZ",
        help="sampling rate of the files, Hz; default: 1000",
    )
    parser.add_argument(
        "--evaluations",
        type=int,
        default=1500,
        metavar="N",
        help="evaluations of the criterion in the search; default: 1500",
    )
    parser.add_argument(
        "--seed", type=seed, default=0, metavar="N", help="seed of the search; default: 0"
    )


def run(args: argparse.Namespace) -> int:
    """Design, write and print; 130 if interrupted with a trajectory kept."""
    from lieid_casadi.discrimination import discriminate
    from lieid_casadi.identification import Fit

    folder = Path(args.output)
    effects_file.load(args.effects_file)
    sizes = sizes_of(args.size)
    fit = Fit.load(args.fit)
    with output.progress("discriminate") as report:
        result = discriminate(
            fit, args.effects, sizes=sizes,
            recordings=shared_options.recordings_of(args.recordings, args, fit),
            level=args.level, duration=args.duration, harmonics=args.harmonics,
            start_pose=args.start_pose, acceleration=args.acceleration, margin=args.margin,
            limits=motion_limits.limits_of(args, fit.model.robot), rate=args.rate,
            evaluations=args.evaluations, seed=args.seed, progress=report,
        )  # fmt: skip
    files = output.Files()
    files.add_json(args.json, result.to_dict())
    result.save(folder, force=args.force)
    files.write()
    show(result, folder)
    return INTERRUPTED if result.interrupted else 0


def sizes_of(texts: list[str]) -> dict[str, list[float]]:
    """Return the sizes that ``--size EFFECT=V1,V2`` states.

    Raises
    ------
    UsageError
    """
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
