"""``lieid sample FIT -n N -o DIR``: physically consistent draws from the posterior of a fit."""

from __future__ import annotations

import argparse

from lieid_casadi.cli import options, output
from lieid_casadi.cli.options import Command
from lieid_casadi.errors import UsageError


def run(args: argparse.Namespace) -> output.Outcome:
    """Draw samples and write them."""
    from lieid_casadi.exporters.samples import export_samples
    from lieid_casadi.identification import Fit

    if args.n < 1:
        raise UsageError(f"-n {args.n}: expected at least 1")
    fit = Fit.load(args.fit)
    with output.progress("sample") as report:
        samples = fit.sample(args.n, seed=args.seed, progress=report)
    made = export_samples(samples, args.output, to=args.to, force=args.force)
    return output.Outcome(
        [
            f"{len(samples)} samples written to {args.output}: {len(made.files)} files",
            "They state the uncertainty of the parameters, not errors of the model.",
            *(f"  ! {note}" for note in made.notes),
        ]
    )


COMMANDS = (
    Command(
        "sample",
        "physically consistent draws from the posterior of a fit",
        "Draw physically consistent parameters from the posterior of a fit of method feasible, for "
        "ensembles and domain randomisation.",
        (
            """
            fit FIT: input  fit to sample
            -n N: int = 100  number of samples
            --to {npz,mjcf,urdf} = npz  models of every sample besides samples.npz
            """,
            options.FOLDER,
            "--seed N: seed = 0  seed of the draws",
            options.EFFECTS_FILE,
        ),
        run,
    ),
)
