"""The state of a fleet in the text format of Prometheus, for node-exporter's textfile collector."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, date, datetime, time

import numpy as np

from lieid_casadi.fleet.alarms import Alarm, read_alarms
from lieid_casadi.fleet.arm_history import ERROR, ArmHistory, read_arms
from lieid_casadi.fleet.history import History

Samples = Iterable[tuple[Mapping[str, str], float]]  # labels and value of each


def prometheus_text(history: History) -> str:
    """Return the state of a fleet in the text exposition format of Prometheus, as gauges."""
    arms = list(read_arms(history, waiting=1))
    alarms = read_alarms(history, open_only=True)
    counts = Counter(alarm.serial for alarm in alarms)
    nights = history.rows(
        "SELECT serial, max(date) FILTER (status = 'done'), count(*) FILTER (status = 'missing'), "
        "arg_max(status, date) FROM nights GROUP BY serial ORDER BY serial"
    )
    runs = history.rows("SELECT status, count(*) FROM runs GROUP BY status ORDER BY status")
    call = history.rows("SELECT epoch(finished), seconds, counts FROM calls ORDER BY finished")
    finished, seconds, last = call[-1] if call else (0.0, 0.0, "{}")
    gauges: list[tuple[str, str, Samples]] = [
        (
            "alarm",
            "Open alarm: part of the joint's torque that the fit no longer predicts.",
            _severities(alarms),
        ),
        (
            "alarms",
            "Number of open alarms of the arm.",
            [({"serial": arm.serial}, float(counts[arm.serial])) for arm in arms],
        ),
        (
            "last_night_timestamp_seconds",
            "Date (UTC) of the arm's last usable recording.",
            [({"serial": arm.serial}, _start_of_day(arm.dates[-1])) for arm in arms],
        ),
        (
            "last_success_timestamp",
            "Date (UTC) of the newest night that was diagnosed, of every arm of the file; or 0.",
            [({"serial": x}, _start_of_day(day) if day else 0.0) for x, day, *_ in nights],
        ),
        (
            "nights_missing",
            "Expected nights of the arm without a recording.",
            [({"serial": serial}, float(count)) for serial, _, count, _ in nights],
        ),
        (
            "newest_night_done",
            "1 if the arm's newest expected night was diagnosed; 0: missing, refused or failed.",
            [({"serial": serial}, float(status == "done")) for serial, *_, status in nights],
        ),
        (
            "error_ratio",
            "Error in motion of the last night over the held-out error of the fit.",
            _error_ratios(arms),
        ),
        ("parameter", "Coefficient of an effect on the last night, SI units.", _coefficients(arms)),
        (
            "runs",
            "Arm-nights in the history by status.",
            [({"status": status}, float(count)) for status, count in runs],
        ),
        (
            "last_run",
            "Arm-nights of the last call of lieid fleet by status.",
            [({"status": x}, float(count)) for x, count in sorted(json.loads(last).items())],
        ),
        ("last_run_timestamp", "When the last call ended.", [({}, float(finished))]),
        ("last_run_seconds", "Duration of the last call.", [({}, float(seconds))]),
    ]
    return "".join(_gauge(f"lieid_fleet_{name}", text, samples) for name, text, samples in gauges)


def _severities(alarms: Sequence[Alarm]) -> Samples:
    for a in alarms:
        labels = {"serial": a.serial, "joint": str(a.joint or ""), "quantity": a.quantity}
        yield labels | {"since": str(a.since)}, a.severity


def _start_of_day(day: date) -> float:
    """Return 00:00 UTC of a day, s since 1970."""
    return datetime.combine(day, time(), UTC).timestamp()


def _error_ratios(arms: Sequence[ArmHistory]) -> Samples:
    for arm in arms:
        for quantity, series in arm.series.items():
            if quantity.name == ERROR:  # its series is the logarithm of the ratio
                labels = {"serial": arm.serial, "joint": str(quantity.joint)}
                yield labels, float(np.exp(series.values[-1]))


def _coefficients(arms: Sequence[ArmHistory]) -> Samples:
    for arm in arms:
        for quantity, series in arm.series.items():
            if quantity.name != ERROR:
                labels = {"serial": arm.serial, "joint": str(quantity.joint)}
                yield labels | {"name": quantity.name}, float(series.values[-1])


def _gauge(name: str, text: str, samples: Samples) -> str:
    lines = [f"# HELP {name} {text}", f"# TYPE {name} gauge"]
    for labels, value in samples:
        shown = ",".join(f'{key}="{_escaped(label)}"' for key, label in labels.items())
        lines.append(f"{name}{{{shown}}} {value!r}" if shown else f"{name} {value!r}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
