"""``lieid compare FIT REC…``: where a fit fails on recordings."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import effects_file, output, shared_options
from lieid_casadi.cli.option_types import InputPath, PictureFile

if TYPE_CHECKING:
    from lieid_casadi.comparison import Comparison
    from lieid_casadi.simulation import WindowDrift


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "compare",
        help="errors of a fit on recordings, per joint",
        description="Compare the torque of a fit with recordings, joint by joint, and the motion "
        "of a simulation of 1 s with the measured one.",
    )
    parser.add_argument("fit", type=InputPath, metavar="FIT", help="fit to compare")
    parser.add_argument(
        "recordings", nargs="+", type=InputPath, metavar="REC", help="recordings to compare it with"
    )
    parser.add_argument(
        "--plot",
        type=PictureFile,
        metavar="FILE",
        help="draw measured, predicted and residual torque",
    )
    shared_options.add_recording_options(parser)
    effects_file.add_option(parser)
    shared_options.add_outputs(parser, html=True)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Compare, print and write."""
    from lieid_casadi.comparison import compare
    from lieid_casadi.identification import Fit
    from lieid_casadi.report import comparison_report
    from lieid_casadi.simulation import window_drift

    effects_file.load(args.effects_file)
    fit = Fit.load(args.fit)
    recordings = shared_options.recordings_of(args.recordings, args, fit)
    comparison = compare(fit, recordings)
    drift = window_drift(fit, recordings)
    files = output.Files()
    files.add_json(args.json, comparison.to_dict() | {"simulation": drift.to_dict()})
    files.add_html(args.html, lambda: comparison_report(fit, comparison, drift))
    files.add_picture(args.plot, comparison.plot)
    files.write()
    print_comparison(comparison, drift)


def print_comparison(comparison: Comparison, drift: WindowDrift | None = None) -> None:
    """Print torque errors per joint, the simulation error beside them, and the largest errors."""
    from lieid_casadi.comparison.comparison import error_table, largest_errors_table, verdict
    from lieid_casadi.simulation.view import window_table

    output.say(verdict(comparison))
    output.show(error_table(comparison))
    if drift is not None:
        output.show(window_table(drift))
        if drift.reason:
            output.say(f"Not simulated: {drift.reason}.")
    output.show(largest_errors_table(comparison))
    output.show_warnings(comparison.warnings)
