"""``lieid compare FIT REC…``: where a fit fails on recordings."""

from __future__ import annotations

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.check import premises_of
from lieid_casadi.cli.options import Args, command


@command("compare", "errors of a fit on recordings, per joint")
def run(args: Args) -> output.Outcome:
    """Compare the torque of a fit with recordings, joint by joint.

    fit FIT: input  fit to compare
    recordings REC …: input  recordings to compare it with
    @RECORDING @DESPITE_CHECK @JSON @HTML
    """
    from lieid_casadi.comparison.comparison import error_table, largest_errors_table, verdict
    from lieid_casadi.report import comparison_report

    fit, recordings = inputs.fit_and_recordings(args)
    premises = premises_of(args, fit, recordings)
    comparison = lieid.compare(fit, recordings)
    return output.Outcome(
        (
            verdict(comparison),
            error_table(comparison),
            largest_errors_table(comparison),
            *comparison.warnings,
        ),
        json=comparison.to_dict() | {"premises": premises},
        html=lambda: comparison_report(fit, comparison),
    )
