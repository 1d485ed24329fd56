"""``lieid sample FIT -n N -o DIR``: physically consistent draws from the posterior of a fit."""

from __future__ import annotations

import argparse

from lieid_casadi.cli import options, output
from lieid_casadi.cli.option_types import InputPath
from lieid_casadi.cli.options import Command, option
from lieid_casadi.errors import UsageError

FORMATS = ("npz", "mjcf", "urdf")


def run(args: argparse.Namespace) -> output.Outcome:
    """Draw samples and write them."""
    from lieid_casadi.exporters.samples import export_samples
    from lieid_casadi.identification import Fit
    from lieid_casadi.identification.uncertainty.posterior_samples import sample_fits

    if args.n < 1:
        raise UsageError(f"-n {args.n}: expected at least 1")
    fit = Fit.load(args.fit)
    with output.progress("sample") as report:
        samples = sample_fits(fit, args.n, seed=args.seed, progress=report)
    made = export_samples(samples, args.output, to=args.to, force=args.force)

    def show() -> None:
        output.say(f"{len(samples)} samples written to {args.output}: {len(made.files)} files")
        output.say("They state the uncertainty of the parameters, not errors of the model.")
        for note in made.notes:
            output.say(f"  ! {note}")

    return output.Outcome(show)


COMMANDS = (
    Command(
        "sample",
        "physically consistent draws from the posterior of a fit",
        "Draw physically consistent parameters from the posterior of a fit of method feasible, for "
        "ensembles and domain randomisation.",
        (
            option("fit FIT", "fit to sample", InputPath),
            option("-n N", "number of samples", int, 100),
            option(
                "--to", "models of every sample besides samples.npz", None, "npz", choices=FORMATS
            ),
            *options.output_folder(),
            options.random_seed("seed of the draws"),
            options.EFFECTS_FILE,
        ),
        run,
    ),
)
