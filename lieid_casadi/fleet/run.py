"""One call of ``lieid fleet``: the nights that are not in the history, run, recorded, judged."""

from __future__ import annotations

import hashlib
import json
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from functools import cached_property

from lieid_casadi import __version__
from lieid_casadi.errors import FleetError, LieidError
from lieid_casadi.fleet.alarms import Alarm, judge_new_nights
from lieid_casadi.fleet.cluster import RunOptions, dask_client, run_on_cluster
from lieid_casadi.fleet.config import Dated, Fleet, FleetArm, valid_at
from lieid_casadi.fleet.history import ArmEntry, History
from lieid_casadi.fleet.night_result import METHOD, ArmNight, Batch, NightResult
from lieid_casadi.fleet.recordings import list_recordings, local_copy, night_of
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.fit import content_of
from lieid_casadi.identification.identify import default_effects
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording
from lieid_casadi.robot import Robot

LOG = logging.getLogger(__name__)
ARMS_AT_ONCE = 200  # whose finished runs are read by one query
PUBLISHING_PART = 0.01  # of a call's time, in which readers get what it has recorded so far


@dataclass(frozen=True)
class FleetRun:
    """Result of a call."""

    counts: dict[str, int]  # status → number of arm-nights of this call
    finished_before: int  # recordings that were in the history
    seconds: float
    new_alarms: tuple[Alarm, ...]
    faults: tuple[str, ...] = ()  # serial number and reason of each that was refused or failed
    silent: tuple[tuple[str, date, str], ...] = ()  # arms whose newest night is not done: status


def run_fleet(
    fleet: Fleet,
    history: History,
    *,
    options: RunOptions | None = None,
    since: date | None = None,
    newest: date | None = None,
    rerun: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> FleetRun:
    """Diagnose the recordings that the history does not have, and record the results.

    Every batch is committed when it is there: a call that ends early is continued by the next.
    """
    settings, start = options or RunOptions(), time.monotonic()
    expected = newest or datetime.now(UTC).date() - timedelta(days=1)
    todo = nights_to_run(fleet, history, newest=expected, since=since, rerun=rerun)
    LOG.info("%d arm-nights to run, %d in the history", len(todo.nights), todo.finished)
    counts: Counter[str] = Counter()
    faults: list[str] = []
    due = start

    def record(batch: Batch) -> None:
        nonlocal due
        history.add(batch)
        for serial, day, status, reason in batch.lines:
            counts[status] += 1
            if status in ("refused", "failed"):
                faults.append(f"{serial}: {reason}")
                LOG.warning("%s %s %s: %s", serial, day, status, reason)
        if (begin := time.monotonic()) >= due:
            history.publish()
            end = time.monotonic()
            due = end + (end - begin) / PUBLISHING_PART
        if progress is not None:
            total = len(todo.nights) + len(todo.unusable)
            progress(counts.total(), total)

    if todo.unusable:
        record(Batch.of(todo.unusable))
    if todo.nights:
        with dask_client(settings) as client:
            run_on_cluster(client, todo.nights, todo.fits, settings, finished=record)
    new = judge_new_nights(history)
    silent = history.set_nights([arm.serial for arm in fleet.arms], expected)
    seconds = time.monotonic() - start
    call = (datetime.now(UTC), seconds, __version__, json.dumps(counts), len(new))
    history.insert("calls", [call])
    for serial, day, status in silent:
        LOG.warning("%s %s: %s", serial, day, status)
    LOG.info("ended after %.1f s: %s, %d new alarms", seconds, json.dumps(counts), len(new))
    return FleetRun(dict(counts), todo.finished, seconds, tuple(new), tuple(faults), tuple(silent))


@dataclass(frozen=True, eq=False)
class NightsToRun:
    """What a call has to do."""

    nights: tuple[ArmNight, ...]
    fits: dict[str, bytes]  # ``fit_sha256`` → content of the fit's file
    #: Recordings without a date, patterns that cannot be listed, and fits that cannot be used.
    unusable: tuple[tuple[ArmNight, NightResult], ...]
    finished: int  # recordings that are in the history


def nights_to_run(
    fleet: Fleet, history: History, *, newest: date, since: date | None = None, rerun: bool = False
) -> NightsToRun:
    """Return the arm-nights that the history does not have; arms are entered into it."""
    first = since or date.min
    nights: list[ArmNight] = []
    unusable: list[tuple[ArmNight, NightResult]] = []
    fits: dict[str, bytes] = {}
    entries, finished, broken = [], 0, 0
    for begin in range(0, len(fleet.arms), ARMS_AT_ONCE):
        arms = fleet.arms[begin : begin + ARMS_AT_ONCE]
        files, runs = history.finished([a.serial for a in arms], METHOD if rerun else None)
        for arm in arms:
            empty = ArmNight(arm.serial, newest.isoformat(), "", "", "")
            try:
                own = fits_of(arm)
            except LieidError as error:
                if broken + 1 == len(fleet.arms):
                    raise
                source = arm.fits[0].value if arm.fits else arm.robot or ""
                failed = replace(empty, recording=source), NightResult("failed", str(error))
                unusable.insert(broken, failed)
                entries.append(ArmEntry(arm.serial, "", 0, ""))
                broken += 1
                continue
            entries.append(_entry(arm, own, newest))
            fits |= {each.value.sha256: each.value.content for each in own}
            for night, reason in recordings_of(arm, fleet, own, empty):
                if reason:
                    unusable.append((night, NightResult("failed", reason)))
                elif night.key in files:
                    finished += 1
                elif date.fromisoformat(night.date) >= first:
                    nights.append(replace(night, done=runs.get(arm.serial, frozenset())))
    history.set_arms(entries, first=newest)
    return NightsToRun(tuple(nights), fits, tuple(unusable), finished)


@dataclass(frozen=True, eq=False)
class LoadedFit:
    """A fit of an arm with the content of its file."""

    fit: Fit
    content: bytes
    path: str = ""  # or URL; empty if the fit was made

    @cached_property
    def sha256(self) -> str:
        """Hash of the content."""
        return hashlib.sha256(self.content).hexdigest()


def fits_of(arm: FleetArm) -> list[Dated[LoadedFit]]:
    """Return the fits of an arm; without a file one is made."""
    found = []
    for entry in arm.fits:
        with local_copy(entry.value) as path:
            found.append(
                Dated(LoadedFit(Fit.load(path), path.read_bytes(), entry.value), entry.first)
            )
    if not found:
        assert arm.robot is not None
        robot = Robot.load(arm.robot)
        train = [_training(arm, robot, location) for location in arm.train]
        fit = identify(Model(robot, arm.effects or default_effects(robot, train).names), train)
        found.append(Dated(LoadedFit(fit, content_of(fit))))
    for each in found:
        _check_arm(arm, each.value.fit)
    return found


def _training(arm: FleetArm, robot: Robot, location: str) -> Recording:
    constants = arm.torque_constants[0].value if arm.torque_constants else None
    names = [joint.name for joint in robot.joints]
    with local_copy(location) as path:
        return Recording.load(path, torque_constants=constants, n=robot.n, joint_names=names)


def _check_arm(arm: FleetArm, fit: Fit) -> None:
    """Refuse entries of the fleet file that do not match the arm's fit."""
    n = fit.model.n
    for entry in arm.torque_constants:
        if len(entry.value) != n:
            raise FleetError(f"arm {arm.serial}: {len(entry.value)} torque constants; expected {n}")
    names = {p.effect.label for p in fit.model.placements} | {c.name for c in fit.model.columns}
    for name, values in arm.limits.items():
        if name not in names:
            expected = ", ".join(sorted(names)) or "no limits: the fit has no effects"
            raise FleetError(f"arm {arm.serial}: limit of {name!r}; expected {expected}")
        if len(values) not in (1, n):
            raise FleetError(f"arm {arm.serial}: {len(values)} limits of {name}; expected 1 or {n}")


def _entry(arm: FleetArm, fits: Sequence[Dated[LoadedFit]], newest: date) -> ArmEntry:
    """Return the row of an arm, with the fit that is valid on the newest night."""
    present = valid_at(fits, newest) or fits[0].value
    first = next(each.first for each in fits if each.value is present)
    limits = {name: list(values) for name, values in arm.limits.items()}
    model = present.fit.model
    return ArmEntry(
        arm.serial, model.robot.name, model.n, present.sha256, limits, present.path, first,
        arm.maintenance,
    )  # fmt: skip


def recordings_of(
    arm: FleetArm, fleet: Fleet, fits: Sequence[Dated[LoadedFit]], empty: ArmNight
) -> Iterator[tuple[ArmNight, str]]:
    """Yield the recordings of an arm, with a reason where date or place is not usable."""
    pattern = fleet.night_pattern(arm.serial)
    for where in arm.recordings:
        try:
            files = list_recordings(where)
        except LieidError as error:
            yield replace(empty, recording=where), str(error)
            continue
        for file in files:
            night = replace(empty, recording=file.location, stamp=file.stamp)
            try:
                day = night_of(file, pattern)
            except FleetError as error:
                yield night, str(error)
                continue
            fit, tool = valid_at(fits, day), valid_at(arm.tools, day)
            if fit is not None and not any(a <= day <= b for a, b in arm.maintenance):
                known = [(p.label, tuple(p.parameters.tolist())) for p in arm.payloads_at(day)]
                yield (
                    replace(
                        night,
                        date=day.isoformat(),
                        fit_sha256=fit.sha256,
                        torque_constants=valid_at(arm.torque_constants, day),
                        tool=None if tool is None else tuple(tool.ravel().tolist()),
                        payloads=tuple(known),
                    ),
                    "",
                )
