"""``lieid compare FIT REC…``: where a fit fails on recordings."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from lieid_casadi.cli import inputs, options, output
from lieid_casadi.cli.check import DESPITE_CHECK, premises_of
from lieid_casadi.cli.option_types import InputPath
from lieid_casadi.cli.options import Command, option, several

if TYPE_CHECKING:
    from lieid_casadi.comparison import Comparison
    from lieid_casadi.simulation import WindowDrift


def run(args: argparse.Namespace) -> output.Outcome:
    """Compare torques, and simulate."""
    from lieid_casadi.comparison import compare
    from lieid_casadi.report import comparison_report
    from lieid_casadi.simulation import window_drift

    fit, recordings = inputs.fit_and_recordings(args)
    premises = premises_of(args, fit, recordings)
    comparison = compare(fit, recordings)
    drift = window_drift(fit, recordings)
    return output.Outcome(
        lambda: print_comparison(comparison, drift),
        json=comparison.to_dict() | {"simulation": drift.to_dict(), "premises": premises},
        html=lambda: comparison_report(fit, comparison, drift),
        plot=comparison.plot,
    )


COMMANDS = (
    Command(
        "compare",
        "errors of a fit on recordings, per joint",
        "Compare the torque of a fit with recordings, joint by joint, and the motion of a "
        "simulation of 1 s with the measured one.",
        (
            option("fit FIT", "fit to compare", InputPath),
            several("recordings REC", "recordings to compare it with"),
            options.plot("draw measured, predicted and residual torque"),
            *options.RECORDING,
            DESPITE_CHECK,
            options.JSON,
            options.HTML,
        ),
        run,
    ),
)


def print_comparison(comparison: Comparison, drift: WindowDrift | None = None) -> None:
    """Print torque errors per joint, the simulation error beside them, and the largest errors."""
    from lieid_casadi.comparison.comparison import error_table, largest_errors_table, verdict
    from lieid_casadi.simulation.simulate import window_table

    output.say(verdict(comparison))
    output.show(error_table(comparison))
    if drift is not None:
        output.show(window_table(drift))
        if drift.reason:
            output.say(f"Not simulated: {drift.reason}.")
    output.show(largest_errors_table(comparison))
    output.show_warnings(comparison.warnings)
