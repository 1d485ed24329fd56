"""``lieid fleet export``: the state of a fleet for Prometheus, its tables as Parquet."""

from __future__ import annotations

import argparse
from typing import Any

from lieid_casadi.cli import output
from lieid_casadi.cli.option_types import InputPath, OutputFile, OutputFolder
from lieid_casadi.errors import UsageError


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "fleet export",
        help="a fleet's state for Prometheus, its history as Parquet",
        description="Write the state of a fleet in the text format of node-exporter's textfile "
        "collector, or the tables of its history as Parquet files.",
    )
    parser.add_argument("history", type=InputPath, metavar="HISTORY", help="history (DuckDB)")
    parser.add_argument(
        "--prometheus", type=OutputFile, metavar="FILE.prom", help="write metrics to this file"
    )
    parser.add_argument(
        "--parquet", type=OutputFolder, metavar="DIR", help="write one file per table"
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="replace the files that lieid wrote into the folder; others are kept",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Write the requested files."""
    from lieid_casadi.fleet.history import History
    from lieid_casadi.fleet.prometheus import prometheus_text
    from lieid_casadi.output_folder import output_folder

    if args.prometheus is None and args.parquet is None:
        raise UsageError("nothing to write; expected --prometheus FILE.prom or --parquet DIR")
    files = output.Files()
    with History(args.history, read_only=True) as history:
        files.add(args.prometheus, lambda: prometheus_text(history).encode())
        if args.parquet is not None:
            with output_folder(args.parquet, force=args.force) as folder:
                history.export_parquet(folder)
    files.write()
