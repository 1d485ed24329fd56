"""``lieid fleet report``: alarms, trends and suspicious recordings of a fleet."""

from __future__ import annotations

import argparse
from typing import Any

from lieid_casadi.cli import output
from lieid_casadi.cli.fleet import night
from lieid_casadi.cli.option_types import InputPath, OutputFile


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "fleet report",
        help="alarms and trends of a fleet",
        description="Print the open alarms of a fleet and write a self-contained report with "
        "trends of every arm.",
    )
    parser.add_argument("history", type=InputPath, metavar="HISTORY", help="history (DuckDB)")
    parser.add_argument("--html", type=OutputFile, metavar="FILE", help="write the report")
    parser.add_argument(
        "--since", type=night, metavar="DATE", help="first night of trends and recordings"
    )
    parser.add_argument("--json", type=OutputFile, metavar="FILE", help="write the alarms as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Print the open alarms and write the report."""
    from lieid_casadi.fleet.alarm_history import read_alarms
    from lieid_casadi.fleet.fleet_report import alarm_table, fleet_report
    from lieid_casadi.fleet.history import History
    from lieid_casadi.fleet.suggested_actions import suggested_action

    files = output.Files()
    with History(args.history, read_only=True) as history:
        alarms = read_alarms(history)
        files.add_html(args.html, lambda: fleet_report(history, since=args.since))
    files.add_json(args.json, {"alarms": [alarm.to_dict() for alarm in alarms]})
    files.write()
    active = [alarm for alarm in alarms if alarm.closed is None]
    output.show(alarm_table(active, with_action=False))
    for alarm in active:
        output.say(f"{alarm.serial}: {alarm.sentence}. Action: {suggested_action(alarm.quantity)}.")
    if not active:
        output.say("No open alarm.")
