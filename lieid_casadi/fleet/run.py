"""One call of ``lieid fleet``: the nights that are not in the history, run, recorded, judged."""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta

from lieid_casadi.errors import FleetError, LieidError
from lieid_casadi.fleet.alarms import Alarm, judge_new_nights
from lieid_casadi.fleet.cluster import RunOptions, dashboard_of, dask_client, run_on_cluster
from lieid_casadi.fleet.config import Fleet, FleetArm
from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.night_result import ArmNight, NightResult
from lieid_casadi.fleet.recordings import list_recordings, local_copy, night_of
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.default_effects import default_effects
from lieid_casadi.identification.fit_file import content_of
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording
from lieid_casadi.robot import Robot


@dataclass(frozen=True, eq=False)
class NightsToRun:
    """What a call has to do.

    Attributes
    ----------
    nights : tuple of ArmNight
    fits : dict
        ``fit_sha256`` → content of the fit's file.
    unusable : tuple of (ArmNight, NightResult)
        Recordings without a date, patterns that cannot be listed, and fits that cannot be used.
    finished : int
        Number of recordings that are in the history.
    """

    nights: tuple[ArmNight, ...]
    fits: dict[str, bytes]
    unusable: tuple[tuple[ArmNight, NightResult], ...]
    finished: int


def nights_to_run(fleet: Fleet, history: History, *, since: date | None = None) -> NightsToRun:
    """Return the arm-nights that the history does not have; arms are entered into it.

    Parameters
    ----------
    fleet : Fleet
    history : History
        Open for writing.
    since : date, optional
        First night to run.

    Raises
    ------
    FitFileError, RobotError, EffectError, FleetError
        An entry of the fleet file does not match the arm's fit, or no arm has a usable fit.
    """
    from lieid_casadi import __version__

    files, runs = history.finished(__version__)
    first = max((d for d in (since, history.kept_from) if d is not None), default=None)
    nights: list[ArmNight] = []
    unusable: list[tuple[ArmNight, NightResult]] = []
    fits: dict[str, bytes] = {}
    arms, broken, finished = [], list[tuple[ArmNight, NightResult]](), 0
    for arm in fleet.arms:
        try:
            fit, content = _fit_of(arm)
        except LieidError as error:
            if len(broken) + 1 == len(fleet.arms):
                raise
            broken.append(_without_fit(arm, str(error)))
            continue
        _check_arm(arm, fit)
        sha = hashlib.sha256(content).hexdigest()
        fits[sha] = content
        limits = {name: list(values) for name, values in arm.limits.items()}
        arms.append((arm.serial, fit.model.robot.name, fit.model.n, sha, limits))
        found, refused = _recordings_of(arm, fleet, sha)
        unusable += refused
        for night in found:
            key = (night.serial, night.recording, night.stamp, sha, night.condition)
            if key in files:
                finished += 1
            elif first is None or date.fromisoformat(night.date) >= first:
                nights.append(replace(night, done=frozenset(runs.get(arm.serial, ()))))
    history.set_arms(arms)
    nights.sort(key=lambda night: night.date)
    return NightsToRun(tuple(nights), fits, (*broken, *unusable), finished)


def _without_fit(arm: FleetArm, reason: str) -> tuple[ArmNight, NightResult]:
    """Return the failed row of an arm whose fit cannot be used."""
    source = arm.fit or arm.robot or ""
    night = ArmNight(arm.serial, date.today().isoformat(), source, "", "")
    return night, NightResult("failed", reason)


def _fit_of(arm: FleetArm) -> tuple[Fit, bytes]:
    """Return the fit of an arm and the content of its file; without a file it is made."""
    if arm.fit is not None:
        with local_copy(arm.fit) as path:
            return Fit.load(path), path.read_bytes()
    assert arm.robot is not None
    robot = Robot.load(arm.robot)
    train = [_training(arm, robot, location) for location in arm.train]
    fit = identify(Model(robot, arm.effects or default_effects(robot, train).names), train)
    return fit, content_of(fit)


def _training(arm: FleetArm, robot: Robot, location: str) -> Recording:
    with local_copy(location) as path:
        return Recording.load(
            path,
            torque_constants=arm.torque_constants,
            n=robot.n,
            joint_names=[joint.name for joint in robot.joints],
        )


def _check_arm(arm: FleetArm, fit: Fit) -> None:
    """Refuse entries of the fleet file that do not match the arm's fit."""
    n = fit.model.n
    if arm.torque_constants is not None and len(arm.torque_constants) != n:
        raise FleetError(
            f"arm {arm.serial}: {len(arm.torque_constants)} torque constants; expected {n}"
        )
    names = {p.effect.label for p in fit.model.placements} | {c.name for c in fit.model.columns}
    for name, values in arm.limits.items():
        if name not in names:
            expected = ", ".join(sorted(names)) or "no limits: the fit has no effects"
            raise FleetError(f"arm {arm.serial}: limit of {name!r}; expected {expected}")
        if len(values) not in (1, n):
            raise FleetError(f"arm {arm.serial}: {len(values)} limits of {name}; expected 1 or {n}")


def _recordings_of(
    arm: FleetArm, fleet: Fleet, fit_sha256: str
) -> tuple[list[ArmNight], list[tuple[ArmNight, NightResult]]]:
    """Return the recordings of an arm, and those whose date or place is not usable."""
    found: list[ArmNight] = []
    unusable: list[tuple[ArmNight, NightResult]] = []
    empty = ArmNight(
        arm.serial,
        date.today().isoformat(),
        "",
        "",
        fit_sha256,
        arm.torque_constants,
        None if arm.tool is None else tuple(arm.tool.ravel().tolist()),
        tuple((p.label, tuple(p.parameters.tolist())) for p in arm.payloads),
    )
    for pattern in arm.recordings:
        try:
            files = list_recordings(pattern)
        except LieidError as error:
            unusable.append((replace(empty, recording=pattern), NightResult("failed", str(error))))
            continue
        for file in files:
            night = replace(empty, recording=file.location, stamp=file.stamp)
            try:
                dated = night_of(file, fleet.night_pattern(arm.serial))
            except FleetError as error:
                unusable.append((night, NightResult("failed", str(error))))
                continue
            found.append(replace(night, date=dated.isoformat()))
    return found, unusable


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
