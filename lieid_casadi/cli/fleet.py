"""``lieid fleet``: many arms every night, and the report, export and upkeep of their history."""

from __future__ import annotations

import json
import logging
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from lieid_casadi.cli import output
from lieid_casadi.cli.check import WRONG
from lieid_casadi.cli.options import Args, command
from lieid_casadi.errors import UsageError
from lieid_casadi.tables import Table

if TYPE_CHECKING:
    from lieid_casadi.fleet.run import FleetRun

NEW_ALARM, SILENT, BOTH = 5, 6, 7  # exit status with --exit-code
MOST_SHOWN = 10  # faults and silent arms that are printed; the history has all


@command(
    "fleet",
    "diagnose the recordings of many arms, every night",
    usage="lieid fleet FLEET.yaml -o HISTORY.duckdb [--scheduler ADDRESS] [--since DATE]",
)
def run(args: Args) -> int:
    """Diagnose the recordings of many arms, and keep the results in a history.

    It runs on this machine or a Dask cluster. See also: lieid fleet report, lieid fleet export,
    lieid fleet acknowledge.

    fleet FLEET.yaml  fleet file
    == diagnosis of recordings
    -o/--output HISTORY: output  history (DuckDB) to add to
    --scheduler ADDRESS  Dask scheduler; default: a cluster on this machine
    --workers N: count  processes on this machine; default: one per core
    --memory SIZE = 2GB  limit of each process
    --timeout S: above = 600  seconds after which an arm-night has failed
    --since DATE: night  first night to run, such as 2026-11-20
    --night DATE: night  newest night on which every arm is expected to have recorded;
        default: yesterday, UTC
    --rerun  compute results of an earlier method of diagnosis again
    --wait S: number = 0  seconds to wait for a run that has the history open
    --exit-code  exit with status 5 if a new alarm was raised, 6 if the newest night of
        an arm is missing, refused or failed, 7 if both
    --most-failed N: int = 0  arms that may be so without status 6
    --on-alarm COMMAND  shell command that gets a line of JSON on its standard input for
        each alarm that is new, or worse: twice as large, or near its limit
    --horizon DAYS: int = 30  time before a limit is reached that is near
    --log FILE: output  append faults, silent arms and alarms, each line with time and level
    """
    from lieid_casadi.fleet.alarms import alarms_to_report, evidence, read_alarms
    from lieid_casadi.fleet.cluster import RunOptions
    from lieid_casadi.fleet.config import read_fleet
    from lieid_casadi.fleet.history import History
    from lieid_casadi.fleet.judging import outliers
    from lieid_casadi.fleet.run import run_fleet

    if args.output is None:
        raise UsageError("no history; expected lieid fleet FLEET.yaml -o HISTORY.duckdb")
    fleet = read_fleet(args.fleet)
    settings = RunOptions(
        scheduler=args.scheduler, workers=args.workers, memory=args.memory, timeout=args.timeout
    )
    start = time.monotonic()
    with _log_file(args.log) as log, History(args.output, wait=args.wait) as history:
        with output.progress("fleet") as report:

            def advanced(finished: int, total: int) -> None:
                rate = finished / (time.monotonic() - start)  # per second
                left = f"{60.0 * rate:.0f} per minute, {(total - finished) / rate:.0f} s left"
                report(f"{finished} of {total} arm-nights, {left}", finished / total)

            result = run_fleet(
                fleet, history, options=settings, since=args.since, newest=args.night,
                rerun=args.rerun, progress=advanced,
            )  # fmt: skip
        changed = alarms_to_report(history, horizon=args.horizon)
        for alarm in changed:
            log.warning("alarm: %s: %s", alarm.serial, alarm.sentence)
        lines = [evidence(history, alarm) for alarm in changed]
        alarms = read_alarms(history, open_only=True)
        unlike = outliers(history)
    new = {(alarm.serial, alarm.raised) for alarm in result.new_alarms}
    _print_run(args, result)
    for alarm in changed:
        kind = "New" if (alarm.serial, alarm.raised) in new else "Worse"
        output.show(f"{kind} alarm: {alarm.serial}: {alarm.sentence}")
    output.show(f"Open alarms: {len(alarms)}. lieid fleet report {args.output} lists them.")
    for outlier in unlike[:MOST_SHOWN]:
        output.show(f"Unlike the other arms of its kind: {outlier.sentence}")
    if args.on_alarm is not None:
        _notify(args.on_alarm, lines)
    silent = len(result.silent) > args.most_failed
    status = {(True, False): NEW_ALARM, (False, True): SILENT, (True, True): BOTH}
    return status.get((bool(new), silent), 0) if args.exit_code else 0


def _print_run(args: Args, result: FleetRun) -> None:
    """Print counts, faults, and arms that have not recorded."""
    counts = ", ".join(f"{number} {status}" for status, number in sorted(result.counts.items()))
    output.show(
        f"Arm-nights of this call: {counts or 'none'}; {result.finished_before} were in the "
        f"history. {result.seconds:.1f} s."
    )
    silent = [f"{serial}: {status} on {day}" for serial, day, status in result.silent]
    for title, lines, rest in (
        ("", result.faults, "column reason of table runs"),
        (f"Arms whose newest night is not diagnosed: {len(silent)}.", silent, "table nights"),
    ):
        if title and lines:
            output.show(title)
        for line in lines[:MOST_SHOWN]:
            output.show(f"  {line}")
        if len(lines) > MOST_SHOWN:
            output.show(f"  and {len(lines) - MOST_SHOWN} more: {rest}")


def _notify(command: str, lines: list[dict[str, Any]]) -> None:
    """Run the user's command with one line of JSON on its standard input for each alarm."""
    if not lines:
        return
    text = "".join(json.dumps(line, ensure_ascii=False) + "\n" for line in lines)
    done = subprocess.run(command, shell=True, input=text.encode(), check=False)
    if done.returncode:
        output.show(f"  ! --on-alarm: the command ended with status {done.returncode}")


@contextmanager
def _log_file(path: str | None) -> Iterator[logging.Logger]:
    """Append what the fleet logs to a file, with time and level."""
    logger = logging.getLogger("lieid_casadi.fleet")
    if path is None:
        yield logger
        return
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(
        logging.Formatter("%(asctime)s %(levelname)s %(message)s", "%Y-%m-%dT%H:%M:%S%z")
    )
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield logger
    finally:
        logger.setLevel(before)
        logger.removeHandler(handler)
        handler.close()


@command("fleet report", "alarms and trends of a fleet")
def report(args: Args) -> output.Outcome:
    """Print the open alarms of a fleet and write a self-contained report with trends of every arm.

    @HISTORY
    --html FILE: output  write the report
    --json FILE: output  write the alarms as JSON
    """
    from lieid_casadi.fleet.alarms import advice, evidence, read_alarms
    from lieid_casadi.fleet.fleet_report import alarm_table, fleet_report
    from lieid_casadi.fleet.history import History
    from lieid_casadi.fleet.judging import outlier_table, outliers

    with History(args.history, read_only=True) as history:
        alarms, unlike = read_alarms(history), outliers(history)
        content = {
            "alarms": [evidence(history, alarm) for alarm in alarms],
            "outliers": [vars(outlier) for outlier in unlike],
        }
        page = fleet_report(history) if args.html is not None else ""
        active = [alarm for alarm in alarms if alarm.closed is None]
        actions = [f"{alarm.serial}: {advice(history, alarm)}" for alarm in active]
    shown: list[str | Table] = [alarm_table(active, with_action=False)]
    shown += [*(actions or ["No open alarm."]), outlier_table(unlike)]
    return output.Outcome(shown, json=content, html=lambda: page)


@command("fleet check", "whether a fleet file is plausible")
def check(args: Args) -> output.Outcome:
    """Check a fleet file before its first night.

    That is: its entries (units of payloads and torque constants, recordings of two arms, files that
    no worker sees), and the premises of every arm on its newest recording. Exit status 4 if
    something is certainly wrong.

    fleet FLEET.yaml  fleet file
    --scheduler ADDRESS  Dask scheduler, whose workers must see the recordings
    @JSON
    """
    from lieid_casadi.fleet.cluster import RunOptions, dask_client
    from lieid_casadi.fleet.config import read_fleet
    from lieid_casadi.fleet.fleet_check import Unseen, check_fleet, check_table, missing_files

    def unseen(paths: Sequence[str]) -> Unseen:
        with dask_client(RunOptions(scheduler=args.scheduler)) as client:
            return dict(client.run(missing_files, list(paths)))

    fleet = read_fleet(args.fleet)
    with output.progress("check") as report:
        found = check_fleet(
            fleet, unseen=None if args.scheduler is None else unseen, progress=report
        )
    lines = [f"{c.serial}: {text}" for c in found for text in c.sentences]
    verdicts = {c.verdict for c in found}
    verdict = next(v for v in ("wrong", "doubtful", "sound") if v in verdicts)
    return output.Outcome(
        [check_table(found), *lines],
        json={"verdict": verdict, "arms": [c.to_dict() for c in found]},
        status=WRONG if verdict == "wrong" else 0,
    )


@command("fleet export", "a fleet's state for Prometheus")
def export(args: Args) -> output.Outcome:
    """Write the state of a fleet in the text format of node-exporter's textfile collector.

    @HISTORY
    --prometheus FILE.prom: output required  write metrics to this file
    """
    from lieid_casadi.fleet.history import History
    from lieid_casadi.fleet.prometheus import prometheus_text

    with History(args.history, read_only=True) as history:
        metrics = prometheus_text(history).encode()
    return output.Outcome(files={"prometheus": lambda: metrics})


@command("fleet acknowledge", "close alarms of an arm after a repair")
def acknowledge(args: Args) -> output.Outcome:
    """Close the open alarms of an arm and start a new baseline.

    Nights after the repair are judged against each other, not against those before it. A run that
    is in progress records it before it judges.

    @CHANGED_HISTORY
    --joint J: int  only alarms and baselines of this joint, from 1
    --note TEXT required  what was found or done
    --date DATE: night  last night before the repair; default: the arm's last night in the
        history
    """
    from lieid_casadi.fleet.alarms import (
        acknowledge,
        acknowledge_later,
        identify_again,
        open_alarms,
    )
    from lieid_casadi.fleet.history import History, HistoryInUse

    options = {"joint": args.joint, "note": args.note, "last": args.date}
    try:
        with History(args.history, new=False, wait=args.wait) as history:
            alarms = open_alarms(history, args.serial, args.joint)
            last = acknowledge(history, args.serial, **options)
            lasting = [alarm for alarm in alarms if alarm.last == last]
            advice = (
                "The arm differed from its fit until the last night. If the change lasts, "
                f"{identify_again(history, lasting[0])}"
                if lasting
                else ""
            )
    except HistoryInUse as error:
        acknowledge_later(args.history, args.serial, **options)
        holder = str(error).partition(";")[0]
        return output.Outcome([f"{holder}. The run acknowledges this before it judges its nights."])
    where = f" of joint {args.joint}" if args.joint else ""
    plural = "" if len(alarms) == 1 else "s"
    text = (
        f"{args.serial}: {len(alarms)} alarm{plural}{where} closed; a new baseline begins with the "
        f"next night. {advice}"
    )
    return output.Outcome([text.rstrip()])


@command("fleet backup", "one complete copy of a history")
def backup(args: Args) -> output.Outcome:
    """Write one file with everything that a history contains, also while a run is in progress.

    @HISTORY
    copy COPY: output  file to write
    """
    from lieid_casadi.fleet.history import backup

    is_of_now = backup(args.history, args.copy)
    when = "" if is_of_now else ", as it was at the latest batch of the run in progress"
    return output.Outcome([f"{args.copy}: a complete copy{when}."])


@command("fleet retire", "take an arm out of service")
def retire(args: Args) -> output.Outcome:
    """Take an arm out of reports, metrics and expected nights, and close its alarms.

    @CHANGED_HISTORY
    --date DATE: night  day; default: today, UTC
    """
    from lieid_casadi.fleet.alarms import retire
    from lieid_casadi.fleet.history import History

    with History(args.history, new=False, wait=args.wait) as history:
        count = retire(history, args.serial, args.date or datetime.now(UTC).date())
    return output.Outcome(
        [
            f"{args.serial}: retired, {count} alarm{'' if count == 1 else 's'} closed; its runs "
            "are kept. Remove it from the fleet file, too: an arm of the file is in service."
        ]
    )
