"""``lieid discriminate FIT EFFECT EFFECT… -o DIR``: the trajectory that separates rival effects."""

from __future__ import annotations

from pathlib import Path

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.excite import INTERRUPTED
from lieid_casadi.cli.options import Args, command
from lieid_casadi.errors import UsageError
from lieid_casadi.tables import Table, make_table


@command("discriminate", "design the trajectory that separates rival effects")
def run(args: Args) -> output.Outcome:
    """Design the trajectory that separates rival effects, and state how long it must be.

    fit FIT: input  fit of the arm
    effects EFFECT …  rival effects, such as stribeck:4; one alone is separated from its absence
    @FOLDER
    --size EFFECT=V1[,V2…] repeated  coefficients and shape parameters of an effect;
        default: fitted, or noise level
    --level P: number = 0.95  confidence level
    --duration S: number = 10  duration of one period, s
    --harmonics N: int = 5  harmonics of each joint
    --start-pose Q …: number  pose at the start and the end, rad; default: a pose found
        within all limits
    @LIMITS
    --rate HZ: number = 1000  sampling rate of the files, Hz
    --evaluations N: int = 1500  evaluations of the criterion in the search
    --seed N: seed = 0  seed of the search
    @JSON
    """
    sizes = dict(_size(text) for text in args.size)
    fit = inputs.fit_of(args, args.fit)
    with output.progress("discriminate") as report:
        result = lieid.discriminate(
            fit, args.effects, sizes=sizes,
            level=args.level, duration=args.duration, harmonics=args.harmonics,
            start_pose=args.start_pose or None, acceleration=args.acceleration or None,
            margin=args.margin, limits=inputs.limits_of(args, fit.model.robot),
            rate=args.rate, evaluations=args.evaluations, seed=args.seed, progress=report,
        )  # fmt: skip
    return output.Outcome(
        shown(result, Path(args.output)),
        json=result.to_dict(),
        folder=lambda: result.save(Path(args.output), force=args.force),
        status=INTERRUPTED if result.interrupted else 0,
    )


def _size(text: str) -> tuple[str, list[float]]:
    """Return effect and values of ``--size EFFECT=V1,V2``."""
    label, _, numbers = text.partition("=")
    try:
        return label, [float(number) for number in numbers.split(",")]
    except ValueError:
        raise UsageError(f"--size {text}: expected EFFECT=V1[,V2…], as stribeck:4=0.5") from None


def shown(result: lieid.Discrimination, folder: Path) -> tuple[str | Table, ...]:
    """Return the result, pair by pair."""
    pairs = make_table(
        "Residual if one effect is true and the other is fitted",
        ["true", "fitted", "residual, % of the effect", "χ² per period", "χ² required"],
        [
            [p.true, p.rival, 100.0 * p.remaining, p.noncentrality, p.needed]
            if p.separable
            else [p.true, p.rival, "can represent it", None, None]
            for p in result.pairs
        ],
    )
    sizes = [f"{label}: {', '.join(f'{x:.4g}' for x in v)}" for label, v in result.sizes.items()]
    return (
        result.summary(),
        pairs,
        f"Sizes: {'; '.join(sizes)}. Designed in {result.solve_seconds:.2g} s.",
        f"Files in {folder}; trajectory.csv is one period of the motion.",
    )
