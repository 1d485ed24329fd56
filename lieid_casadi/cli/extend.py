"""``lieid extend FIT --add stribeck:4 --train A…``: add an effect and fit again."""

from __future__ import annotations

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import Args, command


@command("extend", "add an effect, fit again, compare the errors")
def run(args: Args) -> output.Outcome:
    """Add effects to a fit, fit again, and compare the errors before and after.

    fit FIT: input  fit to extend
    --add A,B:2+3,… required  effects to add
    --train A …: input required  recordings to fit
    --test B …: input  recordings to test on, which are not fitted
    -o/--output fit2.json: output  write the new fit
    @RECORDING @JSON @HTML
    """
    from lieid_casadi.report.reports import extension_report, extension_tables

    fit, train = inputs.fit_and_recordings(args, args.train)
    test = inputs.recordings_of(args.test, args, fit)
    with output.progress("extend") as report:
        extension = lieid.extend(fit, args.add, train, test or None, progress=report)
    return output.Outcome(
        (*extension_tables(extension), *extension.after.warnings),
        fit=extension.after,
        json=extension.to_dict(),
        html=lambda: extension_report(extension),
    )
