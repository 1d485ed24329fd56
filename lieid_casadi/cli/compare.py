"""``lieid compare FIT REC…``: where a fit fails on recordings."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import output, shared_options

if TYPE_CHECKING:
    from lieid_casadi.comparison import Comparison
    from lieid_casadi.identification import Fit


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser("compare", help="errors of a fit on recordings, per joint")
    parser.add_argument("fit", metavar="FIT")
    parser.add_argument("recordings", nargs="+", metavar="REC")
    parser.add_argument(
        "--plot", metavar="FILE", help="draw measured, predicted and residual torque"
    )
    shared_options.add_recording_options(parser)
    shared_options.add_effects_file(parser)
    shared_options.add_outputs(parser, html=True)
    shared_options.add_threads(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Compare, print and write."""
    from lieid_casadi.comparison import compare
    from lieid_casadi.identification import Fit

    output.check_writable(args.json, args.html, args.plot)
    shared_options.load_effects_file(args.effects_file)
    fit = Fit.load(args.fit)
    recordings = shared_options.recordings_of(args.recordings, args, fit.model.robot)
    comparison = compare(fit, recordings)
    output.write_json(args.json, comparison.to_dict())
    if args.html is not None:
        from lieid_casadi.report import comparison_report

        output.write_file(args.html, comparison_report(fit, comparison).encode())
    if args.plot is not None:
        save_figure(args.plot, comparison.plot())
    print_comparison(fit, comparison)


def save_figure(path: str, figure: Any) -> None:
    """Write a figure; the file's ending gives its format."""
    import io
    from pathlib import Path

    from lieid_casadi.errors import UsageError

    kind = Path(path).suffix.lstrip(".").lower() or "png"
    if kind not in figure.canvas.get_supported_filetypes():
        raise UsageError(f"{path}: cannot draw {kind!r} files; expected e.g. .png, .pdf or .svg")
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, dpi=110)
    output.write_file(path, buffer.getvalue())


def print_comparison(fit: Fit, comparison: Comparison) -> None:
    """Print errors per joint and the worst moments."""
    from lieid_casadi.comparison.table import HEADINGS, table_rows
    from lieid_casadi.comparison.verdict import verdict

    output.say(verdict(comparison))
    output.table(
        f"Error, measured − predicted (low-pass {fit.processing.cutoff:.3g} Hz on both; noise: "
        f"{comparison.noise_source.replace('_', ' ')})",
        HEADINGS,
        table_rows(comparison),
    )
    output.table(
        "Worst moments",
        ["recording", "time, s", "joint", "error, N·m"],
        [[w.recording, float(w.time), w.joint + 1, float(w.error)] for w in comparison.worst],
    )
    output.show_warnings(comparison.warnings)
