"""One call of ``lieid fleet``: run what is missing, record it, judge the new nights."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta

from lieid_casadi.fleet.alarm import Alarm
from lieid_casadi.fleet.alarm_history import judge_new_nights
from lieid_casadi.fleet.cluster import RunOptions, dashboard_of, dask_client
from lieid_casadi.fleet.config import Fleet
from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.night_result import ArmNight, NightResult
from lieid_casadi.fleet.nights_to_run import nights_to_run
from lieid_casadi.fleet.scheduling import run_on_cluster


@dataclass(frozen=True)
class FleetProgress:
    """State of a call: arm-nights that are finished, of how many, and since when it runs, s."""

    finished: int
    total: int
    seconds: float

    @property
    def rate(self) -> float:
        """Arm-nights per minute."""
        return 60.0 * self.finished / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def left(self) -> float:
        """Time left, s."""
        return 60.0 * (self.total - self.finished) / self.rate if self.rate else float("inf")


@dataclass(frozen=True)
class FleetRun:
    """Result of a call.

    Attributes
    ----------
    counts : dict
        Status → number of arm-nights of this call.
    finished_before : int
        Recordings that were in the history.
    seconds : float
    new_alarms : tuple of Alarm
    faults : tuple of str
        Serial number and reason of each arm-night that was refused or failed.
    """

    counts: dict[str, int]
    finished_before: int
    seconds: float
    new_alarms: tuple[Alarm, ...]
    faults: tuple[str, ...] = ()


def run_fleet(
    fleet: Fleet,
    history: History,
    *,
    options: RunOptions | None = None,
    since: date | None = None,
    connected: Callable[[str], None] | None = None,
    progress: Callable[[FleetProgress], None] | None = None,
) -> FleetRun:
    """Diagnose the recordings that the history does not have, and record the results.

    Every result is committed when it is there: a call that ends early, for whatever reason, is
    continued by the next one.

    Parameters
    ----------
    fleet : Fleet
    history : History
        Open for writing.
    options : RunOptions, optional
    since : date, optional
        First night to run.
    connected : callable, optional
        Called with the address of the cluster's dashboard, if that answers.
    progress : callable, optional
        Called after each arm-night.

    Raises
    ------
    FleetError
        The fleet file does not match the fits, or no scheduler answers.
    ClusterLost
        The connection to the scheduler was lost.
    """
    settings, start = options or RunOptions(), time.monotonic()
    todo = nights_to_run(fleet, history, since=since)
    counts: Counter[str] = Counter()
    faults: list[str] = []

    def record(night: ArmNight, result: NightResult) -> None:
        history.record(night, result, datetime.now(UTC) - timedelta(seconds=result.seconds))
        counts["repeated" if result.repeated else result.status] += 1
        if result.status != "done":
            faults.append(f"{night.serial}: {result.reason}")
        if progress is not None:
            total = len(todo.nights) + len(todo.unusable)
            progress(FleetProgress(counts.total(), total, time.monotonic() - start))

    for night, result in todo.unusable:
        record(night, result)
    if todo.nights:
        with dask_client(settings) as client:
            dashboard = dashboard_of(client) if connected is not None else None
            if connected is not None and dashboard is not None:
                connected(dashboard)
            run_on_cluster(client, todo.nights, todo.fits, settings, finished=record)
    new = judge_new_nights(history)
    seconds = time.monotonic() - start
    return FleetRun(dict(counts), todo.finished, seconds, tuple(new), tuple(faults))
