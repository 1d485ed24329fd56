"""``lieid payload FIT REC…``: identify the payload at the tool."""

from __future__ import annotations

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.check import premises_of
from lieid_casadi.cli.options import Args, command


@command("payload", "mass, centre of mass and inertia of the payload")
def run(args: Args) -> output.Outcome:
    """Identify mass, centre of mass and inertia of a payload with a fit that was made without it.

    fit FIT: input  fit made without the payload
    recordings REC …: input  recordings measured with the payload
    --cutoff HZ: number  cut-off frequency of the low-pass filter; default: that of the fit
    @RECORDING @DESPITE_CHECK @JSON @HTML
    """
    from lieid_casadi.payload.estimate import error_table, not_identified, quantity_table
    from lieid_casadi.report import payload_report

    fit, recordings = inputs.fit_and_recordings(args)
    premises = premises_of(args, fit, recordings, loaded=True)
    with output.progress("payload") as report:
        payload = lieid.identify_payload(fit, recordings, cutoff=args.cutoff, progress=report)
    unknown = not_identified(payload)
    return output.Outcome(
        (
            payload.sentence,
            quantity_table(payload),
            *(f"  * not identified: {names}; {reason}." for names, reason in unknown),
            error_table(payload),
            *payload.warnings,
        ),
        json=payload.to_dict() | {"premises": premises},
        html=lambda: payload_report(fit, payload),
    )
