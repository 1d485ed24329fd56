"""``lieid fleet``: many arms every night, and the report, export and upkeep of their history."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from lieid_casadi.cli import options, output
from lieid_casadi.cli.option_types import InputPath, OutputFile, OutputFolder, night
from lieid_casadi.cli.options import Command, Group, option
from lieid_casadi.errors import FleetError, UsageError

if TYPE_CHECKING:
    from lieid_casadi.fleet.run import FleetProgress, FleetRun

NEW_ALARM = 5  # exit status with --exit-code
MOST_FAULTS = 10  # printed; the history has all


def run(args: argparse.Namespace) -> int:
    """Run the arm-nights that the history does not have; return the exit status."""
    from lieid_casadi.fleet.alarms import read_alarms
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


def report(args: argparse.Namespace) -> output.Outcome:
    """Print the open alarms and write the report."""
    from lieid_casadi.fleet.alarms import read_alarms, suggested_action
    from lieid_casadi.fleet.fleet_report import alarm_table, fleet_report
    from lieid_casadi.fleet.history import History

    with History(args.history, read_only=True) as history:
        alarms = read_alarms(history)
        page = fleet_report(history, since=args.since) if args.html is not None else ""
    active = [alarm for alarm in alarms if alarm.closed is None]

    def show() -> None:
        output.show(alarm_table(active, with_action=False))
        for alarm in active:
            action = suggested_action(alarm.quantity)
            output.say(f"{alarm.serial}: {alarm.sentence}. Action: {action}.")
        if not active:
            output.say("No open alarm.")

    return output.Outcome(
        show, json={"alarms": [alarm.to_dict() for alarm in alarms]}, html=lambda: page
    )


def export(args: argparse.Namespace) -> output.Outcome:
    """Write the requested files."""
    from lieid_casadi.fleet.history import History
    from lieid_casadi.fleet.prometheus import prometheus_text
    from lieid_casadi.output_folder import output_folder

    if args.prometheus is None and args.parquet is None:
        raise UsageError("nothing to write; expected --prometheus FILE.prom or --parquet DIR")
    with History(args.history, read_only=True) as history:
        metrics = prometheus_text(history).encode() if args.prometheus is not None else b""
        if args.parquet is not None:
            with output_folder(args.parquet, force=args.force) as folder:
                history.export_parquet(folder)
    return output.Outcome(files={"prometheus": lambda: metrics})


def acknowledge(args: argparse.Namespace) -> output.Outcome:
    """Close alarms and say how many."""
    from lieid_casadi.fleet.alarms import acknowledge
    from lieid_casadi.fleet.history import History

    if not Path(args.history).exists():
        raise FleetError(f"{args.history}: no such file; expected a history of lieid fleet")
    with History(args.history) as history:
        count = acknowledge(history, args.serial, joint=args.joint, note=args.note, last=args.date)
    where = f" of joint {args.joint}" if args.joint else ""
    plural = "" if count == 1 else "s"
    return output.Outcome(
        lambda: output.say(
            f"{args.serial}: {count} alarm{plural}{where} closed; a new baseline begins with the "
            "next night."
        )
    )


HISTORY = option("history HISTORY", "history (DuckDB)", InputPath)
COMMANDS = (
    Command(
        "fleet",
        "diagnose the recordings of many arms, every night",
        "Diagnose the recordings of many arms, on this machine or a Dask cluster, and keep the "
        "results in a history. See also: lieid fleet report, lieid fleet export, lieid fleet "
        "acknowledge.",
        (
            option("fleet FLEET.yaml", "fleet file"),
            Group(
                "diagnosis of recordings",
                (
                    options.output_file("HISTORY", "history (DuckDB) to add to"),
                    option(
                        "--scheduler ADDRESS", "Dask scheduler; default: a cluster on this machine"
                    ),
                    option("--workers N", "processes on this machine; default: one per core", int),
                    option("--memory SIZE", "limit of each process", default="2GB"),
                    option(
                        "--timeout S", "seconds after which an arm-night has failed", float, 600.0
                    ),
                    option("--since DATE", "first night to run, such as 2026-11-20", night),
                    option(
                        "--keep DAYS",
                        "remove runs of nights that are older than this, after the run; alarms "
                        "are kept",
                        int,
                    ),
                    option("--exit-code", "exit with status 5 if a new alarm was raised"),
                ),
            ),
        ),
        run,
        usage="lieid fleet FLEET.yaml -o HISTORY.duckdb [--scheduler ADDRESS] [--since DATE]",
    ),
    Command(
        "fleet report",
        "alarms and trends of a fleet",
        "Print the open alarms of a fleet and write a self-contained report with trends of every "
        "arm.",
        (
            HISTORY,
            option("--html FILE", "write the report", OutputFile),
            option("--since DATE", "first night of trends and recordings", night),
            option("--json FILE", "write the alarms as JSON", OutputFile),
        ),
        report,
    ),
    Command(
        "fleet export",
        "a fleet's state for Prometheus, its history as Parquet",
        "Write the state of a fleet in the text format of node-exporter's textfile collector, or "
        "the tables of its history as Parquet files.",
        (
            HISTORY,
            option("--prometheus FILE.prom", "write metrics to this file", OutputFile),
            option("--parquet DIR", "write one file per table", OutputFolder),
            options.FORCE,
        ),
        export,
    ),
    Command(
        "fleet acknowledge",
        "close alarms of an arm after a repair",
        "Close the open alarms of an arm and start a new baseline: nights after the repair are "
        "judged against each other, not against those before it.",
        (
            option("history HISTORY", "history (DuckDB) to change"),
            option("serial SERIAL", "serial number of the arm"),
            option("--joint J", "only alarms and baselines of this joint, from 1", int),
            option("--note TEXT", "what was found or done", required=True),
            option(
                "--date DATE",
                "last night before the repair; default: the arm's last night in the history",
                night,
            ),
        ),
        acknowledge,
    ),
)
