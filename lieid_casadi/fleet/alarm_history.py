"""Alarms of the history: judged night after night, and closed by acknowledgements."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, date, datetime

from lieid_casadi.errors import FleetError
from lieid_casadi.fleet.alarm import Alarm
from lieid_casadi.fleet.alarms import updated_alarms
from lieid_casadi.fleet.arm_history import ArmHistory
from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.judging import judge_night
from lieid_casadi.fleet.read_arms import read_arms

COLUMNS = ", ".join(Alarm.__dataclass_fields__)


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
    arrive late for an earlier night are taken into account from the next night that is judged.
    """
    waiting = history.rows(
        "SELECT DISTINCT date FROM runs WHERE status = 'done' AND started > "
        "coalesce((SELECT max(written) FROM judged), TIMESTAMP '1970-01-01') ORDER BY date"
    )
    if not waiting:
        return []
    written = datetime.now(UTC).replace(tzinfo=None)
    ((latest,),) = history.rows("SELECT max(date) FROM judged")
    nights = [night for (night,) in waiting if latest is None or night >= latest] or [latest]
    arms = read_arms(history)
    alarms = read_alarms(history)
    new: list[Alarm] = []
    for night in nights:
        alarms, raised = alarms_after(alarms, arms, night)
        new += raised
    with history.transaction():
        history.connection.execute("DELETE FROM alarms")
        for alarm in alarms:
            history.insert("alarms", [tuple(vars(alarm).values())])
        history.insert("judged", [(night, written) for night in nights])
    return new


def alarms_after(
    alarms: Sequence[Alarm], arms: Sequence[ArmHistory], night: date
) -> tuple[list[Alarm], list[Alarm]]:
    """Return all alarms after a night, and those that are new.

    Parameters
    ----------
    alarms : sequence of Alarm
        Before the night.
    arms : sequence of ArmHistory
    night : date
    """
    alarmed = {alarm.serial for alarm in alarms if alarm.closed is None}
    judged = {each.arm.serial: each for each in judge_night(arms, night, alarmed=alarmed)}
    kept = [a for a in alarms if a.closed is not None or a.serial not in judged]
    new: list[Alarm] = []
    for serial, each in judged.items():
        own = [a for a in alarms if a.serial == serial and a.closed is None]
        after = updated_alarms(own, each)
        kept += after
        new += after[len(own) :]
    return kept, new


def acknowledge(
    history: History, serial: str, *, joint: int | None = None, note: str, last: date | None = None
) -> int:
    """Close alarms of an arm and start new baselines; return the number of alarms closed.

    Parameters
    ----------
    history : History
        Open for writing.
    serial : str
    joint : int, optional
        From 1; only alarms and baselines of this joint.
    note : str
        What was found or done.
    last : date, optional
        Last night before the repair; the arm's last night in the history if left out.

    Raises
    ------
    FleetError
        The history has no such arm, or the arm no such joint.
    """
    known = history.rows("SELECT joints FROM arms WHERE serial = ?", [serial])
    if not known:
        serials = ", ".join(s for (s,) in history.rows("SELECT serial FROM arms ORDER BY serial"))
        raise FleetError(f"{history.path}: no arm {serial!r}; expected one of {serials}")
    if joint is not None and not 1 <= joint <= known[0][0]:
        raise FleetError(f"arm {serial} has no joint {joint}; expected 1 to {known[0][0]}")
    if last is None:
        ((last,),) = history.rows("SELECT max(date) FROM runs WHERE serial = ?", [serial])
    if last is None:
        raise FleetError(f"{history.path}: arm {serial} has no runs, so nothing to acknowledge")
    chosen = "serial = ? AND closed IS NULL AND (? IS NULL OR joint = ?)"
    values: list[object] = [serial, joint, joint]
    with history.transaction():
        closed = history.rows(f"SELECT series FROM alarms WHERE {chosen}", values)
        history.connection.execute(
            f"UPDATE alarms SET closed = ?, note = ? WHERE {chosen}", [last, note, *values]
        )
        joints = {joint} if joint is None else {joint, *_joints_of(closed)}
        now = datetime.now(UTC).replace(tzinfo=None)
        history.insert("acknowledgements", [(serial, j, last, note, now) for j in joints])
    return len(closed)


def _joints_of(alarms: Sequence[tuple[str]]) -> set[int]:
    """Return the joints of the quantities that alarms are about."""
    labels = [label for (series,) in alarms for label in series.split(",")]
    return {int(label.rpartition(":")[2]) for label in labels if ":" in label}
