"""``lieid extend FIT --add stribeck:4 --train A…``: add an effect and fit again."""

from __future__ import annotations

import argparse
from math import isnan
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import effects_file, output, shared_options
from lieid_casadi.cli.option_types import InputPath, OutputFile, PictureFile
from lieid_casadi.tables import make_table

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lieid_casadi.diagnosis.extend import Extension

    Array = NDArray[np.float64]


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "extend",
        help="add an effect, fit again, compare the errors",
        description="Add effects to a fit, fit again, and compare the errors before and after.",
    )
    parser.add_argument("fit", type=InputPath, metavar="FIT", help="fit to extend")
    parser.add_argument("--add", required=True, metavar="A,B:2+3,…", help="effects to add")
    parser.add_argument(
        "--train", nargs="+", type=InputPath, required=True, metavar="A", help="recordings to fit"
    )
    parser.add_argument(
        "--test",
        nargs="+",
        type=InputPath,
        default=[],
        metavar="B",
        help="recordings to test on, which are not fitted",
    )
    parser.add_argument(
        "-o", "--output", type=OutputFile, metavar="fit2.json", help="write the new fit"
    )
    parser.add_argument(
        "--plot", type=PictureFile, metavar="FILE", help="draw the errors before and after"
    )
    effects_file.add_option(parser)
    shared_options.add_recording_options(parser)
    shared_options.add_outputs(parser)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Fit again, print and write."""
    from lieid_casadi.diagnosis.extend import extend
    from lieid_casadi.identification import Fit

    effects_file.load(args.effects_file)
    fit = Fit.load(args.fit)
    train = shared_options.recordings_of(args.train, args, fit)
    test = shared_options.recordings_of(args.test, args, fit)
    with output.progress("extend") as report:
        extension = extend(fit, args.add, train, test or None, progress=report)
    files = output.Files()
    files.add_fit(args.output, extension.after)
    files.add_json(args.json, extension.to_dict())
    files.add_picture(args.plot, extension.plot)
    files.write()
    print_extension(extension)


def print_extension(extension: Extension) -> None:
    """Print errors per joint before and after, and the new parameters."""
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
    added = ", ".join(extension.added)
    output.show(make_table(f"RMS error, N·m, with {added}", columns, rows))
    output.show(
        make_table(
            "New parameters",
            ["parameter", "value", "std", "unit"],
            [[r["expression"], r["value"], r["std"], r["unit"]] for r in extension.parameters],
        )
    )
    output.show_warnings(extension.after.warnings)
