"""``lieid fleet``: many arms every night, on one machine or a Dask cluster."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, date, datetime, timedelta
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import output
from lieid_casadi.cli.option_types import OutputFile
from lieid_casadi.errors import UsageError

if TYPE_CHECKING:
    from lieid_casadi.fleet.run import FleetProgress, FleetRun

NEW_ALARM = 5  # exit status with --exit-code
MOST_FAULTS = 10  # printed; the history has all


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "fleet",
        help="diagnose the recordings of many arms, every night",
        usage="lieid fleet FLEET.yaml -o HISTORY.duckdb [--scheduler ADDRESS] [--since DATE]",
        description="Diagnose the recordings of many arms, on this machine or a Dask cluster, and "
        "keep the results in a history. See also: lieid fleet report, lieid fleet export, "
        "lieid fleet acknowledge.",
    )
    parser.add_argument("fleet", metavar="FLEET.yaml", help="fleet file")
    run_options = parser.add_argument_group("diagnosis of recordings")
    run_options.add_argument(
        "-o", "--output", type=OutputFile, metavar="HISTORY", help="history (DuckDB) to add to"
    )
    run_options.add_argument(
        "--scheduler", metavar="ADDRESS", help="Dask scheduler; default: a cluster on this machine"
    )
    run_options.add_argument(
        "--workers", type=int, metavar="N", help="processes on this machine; default: one per core"
    )
    run_options.add_argument(
        "--memory", default="2GB", metavar="SIZE", help="limit of each process; default: 2GB"
    )
    run_options.add_argument(
        "--timeout",
        type=float,
        default=600.0,
        metavar="S",
        help="seconds after which an arm-night has failed; default: 600",
    )
    run_options.add_argument(
        "--since", type=night, metavar="DATE", help="first night to run, such as 2026-11-20"
    )
    run_options.add_argument(
        "--keep",
        type=int,
        metavar="DAYS",
        help="remove runs of nights that are older than this, after the run; alarms are kept",
    )
    run_options.add_argument(
        "--exit-code", action="store_true", help="exit with status 5 if a new alarm was raised"
    )
    parser.set_defaults(run=run)


def night(text: str) -> date:
    """Return a date."""
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: expected a date such as 2026-11-20") from None


def run(args: argparse.Namespace) -> int:
    """Run the arm-nights that the history does not have; return the exit status."""
    from lieid_casadi.fleet.alarm_history import read_alarms
    from lieid_casadi.fleet.cluster import RunOptions
    from lieid_casadi.fleet.config import read_fleet
    from lieid_casadi.fleet.history import History
    from lieid_casadi.fleet.run import run_fleet

    if args.output is None:
        raise UsageError("no history; expected lieid fleet FLEET.yaml -o HISTORY.duckdb")
    if args.workers is not None and args.workers < 1:
        raise UsageError(f"--workers {args.workers}: expected 1 or more")
    if args.keep is not None and args.keep < 1:
        raise UsageError(f"--keep {args.keep}: expected 1 day or more")
    if not args.timeout > 0.0:
        raise UsageError(f"--timeout {args.timeout:g}: expected seconds above 0")
    fleet = read_fleet(args.fleet)
    options = RunOptions(
        scheduler=args.scheduler, workers=args.workers, memory=args.memory, timeout=args.timeout
    )
    with History(args.output) as history, _progress() as report:
        result = run_fleet(
            fleet, history, options=options, since=args.since, connected=_connected, progress=report
        )
        if args.keep is not None:
            removed = history.remove_before(datetime.now(UTC).date() - timedelta(days=args.keep))
        alarms = read_alarms(history, open_only=True)
    output.say(_sentence(result))
    for fault in result.faults[:MOST_FAULTS]:
        output.say(f"  {fault}")
    if len(result.faults) > MOST_FAULTS:
        output.say(f"  and {len(result.faults) - MOST_FAULTS} more: column reason of table runs")
    if args.keep is not None:
        output.say(f"{removed} runs of nights more than {args.keep} days ago were removed.")
    for alarm in result.new_alarms:
        output.say(f"New alarm: {alarm.serial}: {alarm.sentence}")
    output.say(f"Open alarms: {len(alarms)}. lieid fleet report {args.output} lists them.")
    return NEW_ALARM if args.exit_code and result.new_alarms else 0


def _connected(dashboard: str) -> None:
    output.say(f"Dask dashboard: {dashboard}")
    sys.stdout.flush()


def _sentence(result: FleetRun) -> str:
    counts = ", ".join(f"{number} {status}" for status, number in sorted(result.counts.items()))
    return (
        f"Arm-nights of this call: {counts or 'none'}; {result.finished_before} were in the "
        f"history. {result.seconds:.1f} s."
    )


@contextmanager
def _progress() -> Iterator[Callable[[FleetProgress], None]]:
    """Show arm-nights, rate and time left on stderr, if it is a terminal."""
    if not sys.stderr.isatty():
        yield lambda state: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("fleet", total=1.0)
        yield lambda state: bar.update(
            task, completed=state.finished, total=state.total, description=_state(state)
        )


def _state(state: FleetProgress) -> str:
    return (
        f"{state.finished} of {state.total} arm-nights, {state.rate:.0f} per minute, "
        f"{state.left:.0f} s left"
    )
