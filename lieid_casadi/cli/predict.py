"""``lieid predict FIT REC -o pred.csv``: torque at the recording's own times."""

from __future__ import annotations

import argparse
from typing import Any

from lieid_casadi.cli import effects_file, output, shared_options
from lieid_casadi.cli.option_types import InputPath, OutputFile


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "predict",
        help="torque of a fit along a recording",
        description="Compute the torque of a fit at the times of a recording.",
    )
    parser.add_argument("fit", type=InputPath, metavar="FIT", help="fit to evaluate")
    parser.add_argument(
        "recording", type=InputPath, metavar="REC", help="recording that states the motion"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=OutputFile,
        required=True,
        metavar="pred.csv",
        help="CSV file with the columns t,tau1…taun",
    )
    shared_options.add_recording_options(parser)
    effects_file.add_option(parser)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Write ``t,tau1…taun``, one row per row of the recording."""
    import io

    import numpy as np

    from lieid_casadi.identification import Fit

    effects_file.load(args.effects_file)
    fit = Fit.load(args.fit)
    (recording,) = shared_options.recordings_of([args.recording], args, fit)
    torque = fit.predict(recording)
    header = ",".join(["t", *(f"tau{j}" for j in range(1, fit.model.n + 1))])
    text = io.StringIO()
    table = np.column_stack([recording.t, torque])
    formats = ["%.15g", *["%.9g"] * fit.model.n]
    np.savetxt(text, table, fmt=formats, delimiter=",", header=header, comments="")
    files = output.Files()
    files.add(args.output, lambda: text.getvalue().encode())
    files.write()
    output.say(f"{len(torque)} rows written to {args.output}")
