"""``lieid fleet acknowledge``: close the alarms of an arm and start new baselines."""

from __future__ import annotations

import argparse
from typing import Any

from lieid_casadi.cli import output
from lieid_casadi.cli.fleet import night
from lieid_casadi.errors import FleetError


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "fleet acknowledge",
        help="close alarms of an arm after a repair",
        description="Close the open alarms of an arm and start a new baseline: nights after the "
        "repair are judged against each other, not against those before it.",
    )
    parser.add_argument("history", metavar="HISTORY", help="history (DuckDB) to change")
    parser.add_argument("serial", metavar="SERIAL", help="serial number of the arm")
    parser.add_argument(
        "--joint", type=int, metavar="J", help="only alarms and baselines of this joint, from 1"
    )
    parser.add_argument("--note", required=True, metavar="TEXT", help="what was found or done")
    parser.add_argument(
        "--date",
        type=night,
        metavar="DATE",
        help="last night before the repair; default: the arm's last night in the history",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Close alarms and say how many."""
    from pathlib import Path

    from lieid_casadi.fleet.alarm_history import acknowledge
    from lieid_casadi.fleet.history import History

    if not Path(args.history).exists():
        raise FleetError(f"{args.history}: no such file; expected a history of lieid fleet")
    with History(args.history) as history:
        count = acknowledge(history, args.serial, joint=args.joint, note=args.note, last=args.date)
    where = f" of joint {args.joint}" if args.joint else ""
    plural = "" if count == 1 else "s"
    output.say(
        f"{args.serial}: {count} alarm{plural}{where} closed; a new baseline begins with the next "
        "night."
    )
