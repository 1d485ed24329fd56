"""Alarms: one per cause, with its name, size, beginning and action; judged night after night."""

from __future__ import annotations

import json
import shlex
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from typing import Any

import numpy as np

from lieid_casadi.atomic_file import reported
from lieid_casadi.effects.placement import labels as specs
from lieid_casadi.errors import FleetError, LieidError
from lieid_casadi.fleet import judging
from lieid_casadi.fleet.arm_history import ERROR, ArmHistory, read_arms
from lieid_casadi.fleet.history import History, left_beside
from lieid_casadi.fleet.night_result import Finding
from lieid_casadi.fleet.recordings import local_copy
from lieid_casadi.identification import Fit
from lieid_casadi.messages import in_unit

#: What to do about an effect, or about a kind of effects by a part of their name.
ACTIONS = {
    "payload": "check what is mounted on the tool; a known payload is entered with from: its night",
    "external_wrench": "check for contact, hoses or cables at the tool",
    "base_tilt": "check the bolts of the base and the level of the floor",
    "encoder_offset": "check the zero position of the joint and its coupling to the encoder",
    "torque_gain": "check current sensor, drive settings and torque constant of the joint",
    "offset": "check the zero of the torque sensor and hoses or cables at the joint",
    "bias_drift": "check the zero of the torque sensor over time",
    "armature": "check that motor and gear of the joint are those of the fit",
    "temperature": "record temperatures, and identify with temperature_friction",
    "coulomb": "check lubrication, seals and brake of the joint; a steady rise indicates wear",
    "position_": "inspect bearing, gear, hoses and balancers of the joint over its whole range",
    "viscous": "check lubricant and temperature of the joint",
    "friction": "check bearings and lubrication of the joint",
    "delay": "check filters of the drives and the time stamps of the recording",
    "error": "look at the diagnosis of the last night's recording",
    "unexplained": "look at the diagnosis of the last night's recording",
    "": "inspect the joint, and identify the arm again if it is in order",
}


@dataclass(frozen=True)
class Alarm:
    """An alarm as in the history."""

    serial: str
    joint: int | None  # from 1; None for the whole arm
    quantity: str  # name of an effect, ``error`` or ``unexplained``
    since: date  # first night of the change
    last: date
    change: float
    std: float | None
    unit: str
    sentence: str
    raised: date  # night on which it became significant
    closed: date | None = None
    note: str = ""  # of the acknowledgement
    severity: float = 0.0  # part of a joint's torque that the fit no longer predicts
    slope: float | None = None  # of a drift, per day, with bounds of 95 % confidence
    limit_date: date | None = None  # when a drift reaches the limit of the fleet file
    series: str = ""  # labels of the quantities that the alarm is about, separated by commas
    slope_low: float | None = None
    slope_high: float | None = None
    reported: float | None = None  # size when it was last reported
    warned: bool = False  # whether it was reported that the limit is near
    limit_early: date | None = None  # for the bounds of the slope; None: never
    limit_late: date | None = None
    rivals: str = ""  # effects that fit as well, separated by commas

    @property
    def action(self) -> str:
        """What to do about it."""
        return next(text for part, text in ACTIONS.items() if part in self.quantity)

    @property
    def labels(self) -> frozenset[str]:
        """Labels of the quantities that the alarm is about."""
        return frozenset(self.series.split(",")) - {""}


UNEXPLAINED = "unexplained"
LATEST_NIGHTS = 5  # since the change, in which an effect must be found to name it
NAMING_PART = 0.5  # of these nights
STANDING_PART = 0.25  # of the nights before the change: found more often, it is no news
SAME_BEGINNING = 2  # nights between the beginnings of one change in several quantities
SEVERITY_NIGHTS = 3  # latest nights over which the severity is taken
FARTHEST_DATE = date(9999, 1, 1).toordinal()


def updated_alarms(
    open_alarms: Sequence[Alarm], judged: judging.JudgedArm, closed: Sequence[Alarm] = ()
) -> list[Alarm]:
    """Return the open alarms of an arm after a night: those before it, and at most one new one.

    Quantities that belong to an open alarm raise no other. All further significant quantities
    together raise one alarm, with the beginning of the most significant. After an alarm that was
    closed though its cause lasts, the fit does not describe the arm either: only the same effect
    or one that the diagnoses of two nights name raises another.
    """
    alarms = [_continued(alarm, judged) for alarm in open_alarms]
    owned = frozenset[str]().union(*(alarm.labels for alarm in alarms))
    changed = [c for c in judged.changed if c.label not in owned]
    repeated = [r for r in judged.repeated if r.label not in owned]
    news: list[judging.ChangedQuantity | judging.RepeatedEffect] = [*changed, *repeated]
    if not news or not (changed or _named(judged.arm, news[0].since)):
        return alarms
    if alarms and news[0].since == judged.arm.dates[-1]:
        return alarms  # one night does not show whether it has another cause
    new = _described(judged.arm, changed, news[0].since)
    lasting = {(a.quantity, a.joint) for a in closed if _lasts(a, judged.arm)}
    if lasting and (new.quantity, new.joint) not in lasting and not _is_found(new, judged.arm):
        return alarms
    labels = {item.label for item in news} | {judging.label_of(new.quantity, new.joint)}
    new = replace(new, series=",".join(sorted(labels)))
    for k, alarm in enumerate(alarms):
        if _is_same(alarm, new, judged.arm):
            alarms[k] = replace(alarm, series=",".join(sorted(alarm.labels | new.labels)))
            return alarms
    return [*alarms, new]


def _lasts(alarm: Alarm, arm: ArmHistory) -> bool:
    """Whether the diagnoses since an alarm was closed still find its effect on most nights."""
    nights = zip(arm.dates, arm.found, strict=True)
    after = [found for night, found in nights if night > (alarm.closed or night)][-LATEST_NIGHTS:]
    own = sum((alarm.quantity, alarm.joint) in found for found in after)
    return own > 0 and own >= NAMING_PART * len(after)


def _is_found(new: Alarm, arm: ArmHistory) -> bool:
    """Whether the diagnoses of two nights name the effect of a new alarm."""
    return len(_named(arm, new.since).get((new.quantity, new.joint), [])) >= 2


def _is_same(alarm: Alarm, new: Alarm, arm: ArmHistory) -> bool:
    """Whether what became significant later has the cause of an open alarm.

    An arm with an open alarm is not described by its fit, so that its coefficients depend on the
    motion: only an effect of another joint that the diagnoses of two nights name is another cause.
    """
    if alarm.joint == new.joint:
        return True
    nights = sum(min(alarm.since, new.since) < d <= max(alarm.since, new.since) for d in arm.dates)
    return nights <= SAME_BEGINNING or not _is_found(new, arm)


def _continued(alarm: Alarm, judged: judging.JudgedArm) -> Alarm:
    """Return an open alarm with the size, beginning and name that this night gives.

    Another motion changes the coefficients of an arm that its fit does not describe. As long as the
    diagnoses find the effect of the alarm, which they found before that as well, this is no news.
    """
    own = [c for c in judged.changed if c.label in alarm.labels]
    if not own and not any(r.label in alarm.labels for r in judged.repeated):  # or not any more
        return replace(alarm, last=min([alarm.last, *judged.arm.dates[-2:-1]]))
    effect, since = (alarm.quantity, alarm.joint), own[0].since if own else alarm.since
    if not own and not _named(judged.arm, since):
        return replace(alarm, last=judged.arm.dates[-1])
    if effect in _named(judged.arm, alarm.since) and effect not in _named(judged.arm, since):
        since = alarm.since
    fresh = _described(judged.arm, own, since)
    kept = {
        name: getattr(alarm, name) for name in ("raised", "note", "series", "reported", "warned")
    }
    return replace(fresh, last=judged.arm.dates[-1], **kept)


def _described(arm: ArmHistory, changed: Sequence[judging.ChangedQuantity], since: date) -> Alarm:
    """Return the alarm of quantities, the most significant first, that have changed since a night.

    It is named after the effect that the diagnoses since then have found. If they have found
    none, it is named after the coefficient that has changed most significantly.
    """
    named = _named(arm, since)
    coefficients = [c for c in changed if c.quantity.name != ERROR]
    own = next((c for c in coefficients if (c.quantity.effect, c.quantity.joint) in named), None)
    if own is None and not named and coefficients:
        first = coefficients[0]  # unless the residual of its joint is not explained
        own = None if (UNEXPLAINED, first.quantity.joint) in arm.found[-1] else first
    alarm = (
        _of_coefficient(arm, own, since) if own is not None
        else _of_finding(arm, named, since) if named
        else _of_error(arm, changed, since)
    )  # fmt: skip
    key, text = (alarm.quantity, alarm.joint), alarm.sentence
    rivals = (named[key][-1].rivals or "") if key in named else ""
    text += f"; rivals: {rivals}" if rivals else ""
    others = [judging.label_of(*other) for other in named if other != key]
    text += f"; also found: {', '.join(others[:3])}" if others else ""
    return replace(alarm, rivals=rivals, sentence=text)


#: Effects and joints (from 1; None: the whole arm) with what the nights have found.
Named = dict[tuple[str, int | None], list[Finding]]


def _named(arm: ArmHistory, since: date) -> Named:
    """Return the effects that the diagnoses since a night have found, the largest first."""
    first = sum(night < since for night in arm.dates)
    after = arm.found[first:][-LATEST_NIGHTS:]
    found: dict[tuple[str, int | None], list[Finding]] = {}
    for key in {key for night in after for key in night if key[0] != UNEXPLAINED}:
        own = [night[key] for night in after if key in night]
        before = arm.found[arm.baseline_of(key[1]) : first]
        standing = sum(key in night for night in before) > STANDING_PART * len(before)
        if len(own) >= NAMING_PART * len(after) and not standing:
            found[key] = own
    size = {key: len(own) * float(np.mean([f.severity for f in own])) for key, own in found.items()}
    return {key: found[key] for key in sorted(found, key=lambda k: (-size[k], k[0], k[1] or 0))}


def _of_finding(arm: ArmHistory, named: Named, since: date) -> Alarm:
    """Return the alarm that is named after the largest effect."""
    (effect, joint), own = next(iter(named.items()))
    changes = [f.change for f in own]
    change, unit = float(np.median(changes)), own[-1].unit
    stds = [f.std for f in own if f.std is not None]
    std = float(np.mean(stds)) if stds else None
    if len(changes) > 2:
        std = max(std or 0.0, float(np.std(changes, ddof=1)) / float(np.sqrt(len(changes))))
    where = f"joint {joint}" if joint else "the arm"
    text = f"{effect} of {where} since {since}: {_amount(change, std, unit)}"
    return _alarm(arm, since, (effect, joint), change, std, unit, text)


def _of_coefficient(arm: ArmHistory, item: judging.ChangedQuantity, since: date) -> Alarm:
    """Return the alarm about a coefficient, with slope and limit of a drift."""
    change, quantity = item.change, item.quantity
    unit, now = arm.units[quantity], change.level + change.size
    text = (
        f"{quantity.name} of joint {quantity.joint} since {since}: "
        f"{_amount(change.size, change.std, unit)}, from {change.level:.4g} to {now:.4g} {unit}"
    )
    key = quantity.effect, quantity.joint
    alarm = _alarm(arm, since, key, change.size, change.std, unit, text)
    if change.kind != "drift":
        return alarm
    limit, early, late = _limit_dates(arm, item)
    text += f"; drift of {change.slope_low:.3g} to {change.slope_high:.3g} {unit} per day (95 %)"
    if limit is not None:
        text += f"; reaches its limit on {limit} ({early} to {late or 'later'})"
    return replace(
        alarm, sentence=text, slope=change.slope, slope_low=change.slope_low,
        slope_high=change.slope_high, limit_date=limit, limit_early=early, limit_late=late,
    )  # fmt: skip


def _of_error(arm: ArmHistory, changed: Sequence[judging.ChangedQuantity], since: date) -> Alarm:
    """Return the alarm about errors that no effect of the library explains."""
    item = next((c for c in changed if c.quantity.name == ERROR), changed[0])
    joint, factor = item.quantity.joint, float(np.exp(item.change.size))
    text = f"error of joint {joint} since {since}: {factor:.3g} times as large as before"
    unexplained = arm.found[-1].get((UNEXPLAINED, joint))
    if unexplained is not None:
        text += f"; not explained by one effect: {unexplained.sentence}"
    quantity = ERROR if unexplained is None else UNEXPLAINED
    size = factor - 1.0, factor * item.change.std
    return _alarm(arm, since, (quantity, joint), *size, "1", text)


def _alarm(
    arm: ArmHistory,
    since: date,
    key: tuple[str, int | None],
    change: float,
    std: float | None,
    unit: str,
    text: str,
) -> Alarm:
    """Return the alarm of an arm about an effect or quantity of a joint, raised this night."""
    quantity, joint = key
    last, severity = arm.dates[-1], float(np.median(arm.shares[-SEVERITY_NIGHTS:]))
    return Alarm(
        arm.serial, joint, quantity, since, last, change, std, unit, text, last, severity=severity
    )


def _limit_dates(arm: ArmHistory, item: judging.ChangedQuantity) -> list[date | None]:
    """Return when a drift reaches its limit: by its slope, the steepest and the flattest one."""
    quantity = item.quantity
    limits = arm.limits.get(quantity.name) or arm.limits.get(quantity.effect)
    if not limits:
        return [None] * 3
    limit = limits[quantity.joint - 1] if len(limits) > 1 else limits[0]
    days = item.change.days_of_limit(float(arm.dates[-1].toordinal()), limit)
    return [
        None if day is None or day >= FARTHEST_DATE else date.fromordinal(int(np.ceil(day)))
        for day in days
    ]


def _amount(change: float, std: float | None, unit: str) -> str:
    return in_unit(f"{change:+.3g}" if std is None else f"{change:+.3g} ± {std:.2g}", unit)


COLUMNS = ", ".join(Alarm.__dataclass_fields__)
WORSE = 2.0  # growth of an alarm's size from which on it is reported again


def read_alarms(history: History, *, open_only: bool = False) -> list[Alarm]:
    """Return the alarms, the most severe first."""
    where = "WHERE closed IS NULL " if open_only else ""
    rows = history.rows(
        f"SELECT {COLUMNS} FROM alarms {where}ORDER BY severity DESC, since, serial, joint"
    )
    return [Alarm(*row) for row in rows]


def judge_new_nights(history: History) -> list[Alarm]:
    """Judge the nights that have runs which were not judged yet; return the new alarms.

    Nights are judged one after another, as if each had been judged on its own morning. Runs that
    arrive late for an earlier night are taken into account from the next night that is judged. A
    new fit starts a new baseline, and closes the alarms that were raised before it.
    """
    _acknowledge_left(history)
    history.connection.execute(
        "UPDATE alarms SET closed = a.fit_from, note = 'new fit' FROM arms a WHERE "
        "alarms.serial = a.serial AND closed IS NULL AND alarms.raised < a.fit_from "
        "AND a.fit_from <= (SELECT max(date) FROM runs)"
    )
    waiting = history.rows(
        "SELECT DISTINCT date FROM runs WHERE status = 'done' AND started > "
        "coalesce((SELECT max(written) FROM judged), TIMESTAMPTZ 'epoch') ORDER BY date"
    )
    if not waiting:
        return []
    written = datetime.now(UTC)
    ((latest,),) = history.rows("SELECT max(date) FROM judged")
    nights = [night for (night,) in waiting if latest is None or night >= latest] or [latest]
    arms = list(read_arms(history, waiting=len(nights)))
    alarms = read_alarms(history)
    new: list[Alarm] = []
    for night in nights:
        alarms, raised = alarms_after(alarms, arms, night)
        new += raised
    _write_alarms(history, alarms)
    history.insert("judged", [(night, written) for night in nights])
    return new


def _write_alarms(history: History, alarms: Sequence[Alarm]) -> None:
    with history.transaction():
        history.connection.execute("DELETE FROM alarms")
        history.insert("alarms", [tuple(vars(alarm).values()) for alarm in alarms])


def alarms_after(
    alarms: Sequence[Alarm], arms: Sequence[ArmHistory], night: date
) -> tuple[list[Alarm], list[Alarm]]:
    """Return all alarms after a night, and those that are new."""
    alarmed = defaultdict[str, set[int | None]](set)
    for alarm in alarms:
        if alarm.closed is None:
            alarmed[alarm.serial].add(alarm.joint)
    judged = {each.arm.serial: each for each in judging.judge_night(arms, night, alarmed=alarmed)}
    kept = [a for a in alarms if a.closed is not None or a.serial not in judged]
    new: list[Alarm] = []
    for serial, each in judged.items():
        own = [a for a in alarms if a.serial == serial and a.closed is None]
        closed = [a for a in alarms if a.serial == serial and a.closed is not None]
        after = updated_alarms(own, each, closed)
        kept += after
        new += after[len(own) :]
    return kept, new


def alarms_to_report(history: History, *, horizon: int = 0) -> list[Alarm]:
    """Return open alarms that were not reported yet, or are worse; they are noted as reported.

    An alarm is worse if its change is `WORSE` times that of the last report, or if a drift reaches
    its limit within ``horizon`` days for the first time.
    """
    alarms = read_alarms(history)
    chosen: list[Alarm] = []
    for k, alarm in enumerate(alarms):
        size = abs(alarm.change)
        near = alarm.limit_date is not None and (alarm.limit_date - alarm.last).days <= horizon
        grown = alarm.reported is None or size >= WORSE * alarm.reported > 0.0
        if alarm.closed is None and (grown or (near and not alarm.warned)):
            reported = size if grown else alarm.reported
            alarms[k] = replace(alarm, reported=reported, warned=alarm.warned or near)
            chosen.append(alarms[k])
    if chosen:
        _write_alarms(history, alarms)
    return chosen


def evidence(history: History, alarm: Alarm) -> dict[str, Any]:
    """Return an alarm for JSON, with what to do, the latest recording and a command to see it."""
    recording, _, fit = next(iter(_latest_recordings(history, alarm)), (None, None, None))
    command = shlex.join(["lieid", "workbench", fit, recording]) if recording and fit else None
    fields = {k: v.isoformat() if isinstance(v, date) else v for k, v in vars(alarm).items()}
    fields["rivals"] = alarm.rivals.split(", ") if alarm.rivals else []
    return fields | {"action": alarm.action, "recording": recording, "command": command}


def advice(history: History, alarm: Alarm) -> str:
    """Return what is known of an alarm, what to do about it, and the command to see it."""
    command = evidence(history, alarm)["command"]
    seen = f" To see it: {command}" if command else ""
    return f"{alarm.sentence}. Action: {alarm.action}.{seen}"


def identify_again(history: History, alarm: Alarm) -> str:
    """Return what to do with an arm that differs from its fit since an alarm: identify it again."""
    rows = _latest_recordings(history, alarm)
    recordings = [recording for recording, *_ in rows]
    old, first = rows[0][2] if rows else "", alarm.last + timedelta(days=1)
    new, robot, effects = f"{alarm.serial}-{first}.json", "ROBOT", list[str]()
    with suppress(LieidError), local_copy(old) as path:
        model = Fit.load(path).model
        robot, effects = old, ["--effects", ",".join(specs(model.placements, model.n))]
    command = shlex.join(["lieid", "identify", robot, *recordings, *effects, "-o", new])
    return (
        f"identify the arm again: {command}, and in the fleet file fit: [{{path: {old}}}, "
        f"{{path: {new}, from: {first}}}]. As long as the diagnoses find this change, only effects "
        "that they find raise another alarm."
    )


def _latest_recordings(history: History, alarm: Alarm) -> list[tuple[Any, ...]]:
    """Return the latest recordings since an alarm's beginning, with their dates and the fit."""
    return history.rows(
        "SELECT DISTINCT recording, date, a.fit FROM runs r JOIN arms a USING (serial, fit_sha256) "
        "WHERE serial = ? AND date >= ? AND status = 'done' ORDER BY date DESC, recording LIMIT 5",
        [alarm.serial, alarm.since],
    )


def open_alarms(history: History, serial: str, joint: int | None) -> list[Alarm]:
    """Return the open alarms of an arm, or of one joint from 1."""
    joints = _known_arm(history, serial)
    if joint is not None and not 1 <= joint <= joints:
        raise FleetError(f"arm {serial} has no joint {joint}; expected 1 to {joints}")
    alarms = read_alarms(history, open_only=True)
    return [a for a in alarms if a.serial == serial and joint in (None, a.joint)]


def acknowledge(
    history: History, serial: str, *, joint: int | None = None, note: str, last: date | None = None
) -> date:
    """Close alarms of an arm, or of one joint from 1, and start new baselines; return ``last``.

    ``last`` is the last night before the repair, by default the arm's last night in the history.
    """
    closed = open_alarms(history, serial, joint)
    last = last or _last_night(history, serial)
    labels = [label for alarm in closed for label in alarm.labels if ":" in label]
    concerned = {joint} | ({int(x.rpartition(":")[2]) for x in labels} if joint else set())
    with history.transaction():
        history.rows(
            "UPDATE alarms SET closed = ?, note = ? WHERE serial = ? AND closed IS NULL "
            "AND (? IS NULL OR joint = ?)",
            [last, note, serial, joint, joint],
        )
        now = datetime.now(UTC)
        history.insert("acknowledgements", [(serial, j, last, note, now) for j in concerned])
    return last


def acknowledge_later(
    path: str, serial: str, *, joint: int | None, note: str, last: date | None
) -> None:
    """Leave what `acknowledge` does to the run that has a history open, or to the next one."""
    with History(path, read_only=True) as history:
        open_alarms(history, serial, joint)  # refuses other arms and joints
        night = (last or _last_night(history, serial)).isoformat()
    with reported(path), left_beside(path).open("a", encoding="utf-8") as file:
        file.write(json.dumps([serial, joint, note, night]) + "\n")


def _acknowledge_left(history: History) -> None:
    """Acknowledge what was left during a run."""
    left = left_beside(history.path)
    while left.exists():
        text = left.read_text("utf-8")
        for line in text.splitlines():
            serial, joint, note, night = json.loads(line)
            last = date.fromisoformat(night)
            acknowledge(history, serial, joint=joint, note=note, last=last)
        if left.read_text("utf-8") == text:  # nothing was added meanwhile
            left.unlink()


def _last_night(history: History, serial: str) -> date:
    ((last,),) = history.rows("SELECT max(date) FROM runs WHERE serial = ?", [serial])
    if not isinstance(last, date):
        raise FleetError(f"{history.path}: arm {serial} has no runs, so nothing to acknowledge")
    return last


def retire(history: History, serial: str, day: date) -> int:
    """Take an arm out of reports, metrics and expected nights; return how many alarms it closes."""
    _known_arm(history, serial)
    with history.transaction():
        history.rows("UPDATE arms SET retired = ? WHERE serial = ?", [day, serial])
        history.rows("DELETE FROM nights WHERE serial = ?", [serial])
        closed = history.rows(
            "UPDATE alarms SET closed = ?, note = 'retired' WHERE serial = ? AND closed IS NULL "
            "RETURNING serial",
            [day, serial],
        )
    return len(closed)


def _known_arm(history: History, serial: str) -> int:
    """Return the number of joints of an arm that the history has."""
    known = history.rows("SELECT joints FROM arms WHERE serial = ?", [serial])
    if not known:
        serials = ", ".join(s for (s,) in history.rows("SELECT serial FROM arms ORDER BY serial"))
        raise FleetError(f"{history.path}: no arm {serial!r}; expected one of {serials}")
    return int(known[0][0])
