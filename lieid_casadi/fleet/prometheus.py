"""The state of a fleet in the text format of Prometheus, for node-exporter's textfile collector."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, time

import numpy as np

from lieid_casadi.fleet.alarm_history import read_alarms
from lieid_casadi.fleet.arm_history import ERROR, read_arms
from lieid_casadi.fleet.history import History

Samples = Iterable[tuple[Mapping[str, str], float]]


def prometheus_text(history: History) -> str:
    """Return alarms, last nights, errors, coefficients and numbers of runs as metrics."""
    arms = read_arms(history)
    alarms = read_alarms(history, open_only=True)
    runs = history.rows("SELECT status, count(*) FROM runs GROUP BY status ORDER BY status")
    parts = [
        _gauge(
            "lieid_fleet_alarm",
            "Open alarm: part of the joint's torque that the fit no longer predicts.",
            [
                (
                    {
                        "serial": a.serial, "joint": str(a.joint or ""), "quantity": a.quantity,
                        "since": str(a.since),
                    },
                    a.severity,
                )
                for a in alarms
            ],
        ),
        _gauge(
            "lieid_fleet_alarms",
            "Number of open alarms of the arm.",
            [
                ({"serial": arm.serial}, float(sum(a.serial == arm.serial for a in alarms)))
                for arm in arms
            ],
        ),
        _gauge(
            "lieid_fleet_last_night_timestamp_seconds",
            "Date (UTC) of the arm's last usable recording.",
            [
                (
                    {"serial": arm.serial},
                    datetime.combine(arm.dates[-1], time(), UTC).timestamp(),
                )
                for arm in arms
            ],
        ),
        _gauge(
            "lieid_fleet_error_ratio",
            "Error in motion of the last night over the held-out error of the fit.",
            [
                (
                    {"serial": arm.serial, "joint": str(quantity.joint)},
                    float(np.exp(series.values[-1])),
                )
                for arm in arms
                for quantity, series in arm.series.items()
                if quantity.name == ERROR
            ],
        ),
        _gauge(
            "lieid_fleet_parameter",
            "Coefficient of an effect on the last night, SI units.",
            [
                (
                    {"serial": arm.serial, "joint": str(quantity.joint), "name": quantity.name},
                    float(series.values[-1]),
                )
                for arm in arms
                for quantity, series in arm.series.items()
                if quantity.name != ERROR
            ],
        ),
        _gauge(
            "lieid_fleet_runs",
            "Arm-nights in the history by status.",
            [({"status": status}, float(count)) for status, count in runs],
        ),
    ]  # fmt: skip
    return "".join(parts)


def _gauge(name: str, text: str, samples: Samples) -> str:
    lines = [f"# HELP {name} {text}", f"# TYPE {name} gauge"]
    for labels, value in samples:
        shown = ",".join(f'{key}="{_escaped(label)}"' for key, label in labels.items())
        lines.append(f"{name}{{{shown}}} {value!r}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
