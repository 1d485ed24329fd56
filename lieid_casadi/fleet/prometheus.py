"""The state of a fleet in the text format of Prometheus, for node-exporter's textfile collector."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, date, datetime, time

import numpy as np

from lieid_casadi.fleet.alarms import Alarm, read_alarms
from lieid_casadi.fleet.arm_history import ERROR, ArmHistory, read_arms
from lieid_casadi.fleet.history import History

Samples = Iterable[tuple[Mapping[str, str], float]]  # labels and value of each


def prometheus_text(history: History) -> str:
    """Return alarms, last nights, errors, coefficients and numbers of runs as metrics.

    Parameters
    ----------
    history : History

    Returns
    -------
    str
        Gauges in the text exposition format of Prometheus, each with its help line.
    """
    arms = read_arms(history)
    alarms = read_alarms(history, open_only=True)
    runs = history.rows("SELECT status, count(*) FROM runs GROUP BY status ORDER BY status")
    parts = [
        _gauge(
            "lieid_fleet_alarm",
            "Open alarm: part of the joint's torque that the fit no longer predicts.",
            _severities(alarms),
        ),
        _gauge(
            "lieid_fleet_alarms",
            "Number of open alarms of the arm.",
            [({"serial": arm.serial}, _count(alarms, arm)) for arm in arms],
        ),
        _gauge(
            "lieid_fleet_last_night_timestamp_seconds",
            "Date (UTC) of the arm's last usable recording.",
            [({"serial": arm.serial}, _start_of_day(arm.dates[-1])) for arm in arms],
        ),
        _gauge(
            "lieid_fleet_error_ratio",
            "Error in motion of the last night over the held-out error of the fit.",
            _error_ratios(arms),
        ),
        _gauge(
            "lieid_fleet_parameter",
            "Coefficient of an effect on the last night, SI units.",
            _coefficients(arms),
        ),
        _gauge(
            "lieid_fleet_runs",
            "Arm-nights in the history by status.",
            [({"status": status}, float(count)) for status, count in runs],
        ),
    ]
    return "".join(parts)


def _severities(alarms: Sequence[Alarm]) -> Samples:
    for a in alarms:
        labels = {"serial": a.serial, "joint": str(a.joint or ""), "quantity": a.quantity}
        yield labels | {"since": str(a.since)}, a.severity


def _count(alarms: Sequence[Alarm], arm: ArmHistory) -> float:
    return float(sum(alarm.serial == arm.serial for alarm in alarms))


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
        lines.append(f"{name}{{{shown}}} {value!r}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
