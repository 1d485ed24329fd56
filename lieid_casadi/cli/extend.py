"""``lieid extend FIT --add stribeck:4 --train A…``: add an effect and fit again."""

from __future__ import annotations

import argparse
from math import isnan
from typing import TYPE_CHECKING

from lieid_casadi.cli import inputs, options, output
from lieid_casadi.cli.options import Command
from lieid_casadi.errors import LieidWarning
from lieid_casadi.tables import Table, make_table

if TYPE_CHECKING:
    from lieid_casadi.arrays import Array
    from lieid_casadi.diagnosis.extend import Extension


def run(args: argparse.Namespace) -> output.Outcome:
    """Fit again."""
    from lieid_casadi.diagnosis.extend import extend

    fit, train = inputs.fit_and_recordings(args, args.train)
    test = inputs.recordings_of(args.test, args, fit)
    with output.progress("extend") as report:
        extension = extend(fit, args.add, train, test or None, progress=report)
    return output.Outcome(
        shown(extension), fit=extension.after, json=extension.to_dict(), plot=extension.plot
    )


COMMANDS = (
    Command(
        "extend",
        "add an effect, fit again, compare the errors",
        "Add effects to a fit, fit again, and compare the errors before and after.",
        (
            """
            fit FIT: input  fit to extend
            --add A,B:2+3,… required  effects to add
            --train A …: input required  recordings to fit
            --test B …: input  recordings to test on, which are not fitted
            -o/--output fit2.json: output  write the new fit
            --plot FILE: picture  draw the errors before and after
            """,
            *options.RECORDING,
            options.JSON,
        ),
        run,
    ),
)


def shown(extension: Extension) -> tuple[Table | LieidWarning, ...]:
    """Return errors per joint before and after, and the new parameters."""
    held_out = "cross-validated" if extension.rms_test is None else "test"
    columns = ["joint", f"{held_out} in motion", "after", "%"]
    pairs: list[Array] = [extension.held_out, extension.rms_train]
    if extension.rms_test_at_rest is not None:
        columns += ["at rest", "after", "%"]
        pairs.insert(1, extension.rms_test_at_rest)
    columns += ["train", "after", "%"]
    rows: list[list[object]] = []
    for j, joint in enumerate(extension.after.model.robot.joints):
        row: list[object] = [f"{j + 1} {joint.name}"]
        for pair in pairs:
            before, after = float(pair[0][j]), float(pair[1][j])
            change = 100.0 * (after / before - 1.0)
            row += [before, after, None if isnan(change) else f"{change:+.1f}"]
        rows.append(row)
    parameters = make_table(
        "New parameters",
        ["parameter", "value", "std", "unit"],
        [[r["expression"], r["value"], r["std"], r["unit"]] for r in extension.parameters],
    )
    errors = make_table(f"RMS error, N·m, with {', '.join(extension.added)}", columns, rows)
    return (errors, parameters, *extension.after.warnings)
