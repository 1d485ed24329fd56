"""The report of a fleet: alarms, all arms, suspicious recordings, and the trends of each arm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.fleet.alarms import Alarm, advice, read_alarms
from lieid_casadi.fleet.arm_history import ERROR, ArmHistory, read_arms
from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.judging import outlier_table, outliers
from lieid_casadi.plot_style import ERROR as ERROR_COLOUR
from lieid_casadi.plot_style import GRID, SMALL, Figure, new_figure, title
from lieid_casadi.report import Section, data_uri, render
from lieid_casadi.report.page import table_section
from lieid_casadi.tables import Table, make_table

BASELINE = 3  # nights whose median is the reference of relative changes
MOST_EFFECTS = 3  # panels of coefficients


def plot_trends(arm: ArmHistory, alarms: Sequence[Alarm]) -> Figure:
    """Draw each effect's first coefficient, the errors, the temperature and the alarms' nights."""
    names: dict[str, str] = {}  # of each effect, the name of its first coefficient
    for quantity in arm.series:
        if quantity.name != ERROR:
            names.setdefault(quantity.effect, quantity.name)
    panels = [_coefficient(arm, name) for name in list(names.values())[:MOST_EFFECTS]]
    errors = {q.joint: np.exp(s.values) for q, s in arm.series.items() if q.name == ERROR}
    panels.append(("error in motion / error that the fit expects", errors))
    warm = {q.joint: s.temperature for q, s in arm.series.items() if s.has_temperature}
    if warm:
        panels.append(("mean temperature, °C", warm))
    figure = new_figure(9.5, 1.7 * len(panels) + 0.4)
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    nights = np.array(arm.dates, dtype="datetime64[D]")
    for ax, (text, lines) in zip(axes, panels, strict=True):
        for joint, values in sorted(lines.items()):
            ax.plot(
                nights, values, color=f"C{(joint - 1) % 10}", label=f"joint {joint}",
                linewidth=1.2, marker=".", markersize=3.0,
            )  # fmt: skip
        ax.grid(True, linewidth=0.6, color=GRID)
        ax.set_axisbelow(True)
        ax.tick_params(labelsize=SMALL)
        ax.spines[["top", "right"]].set_visible(False)
        title(ax, text)
        for alarm in alarms:
            ax.axvline(np.datetime64(alarm.since), color=ERROR_COLOUR, linewidth=1.0, alpha=0.7)
        if lines is errors:
            ax.set_yscale("log")
            ax.legend(fontsize=SMALL, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    return figure


def _coefficient(arm: ArmHistory, name: str) -> tuple[str, dict[int, Array]]:
    """Return title and lines (joint → values) of a coefficient, as change from the first nights."""
    lines, unit = {}, ""
    for quantity, series in arm.series.items():
        if quantity.name == name:
            reference = float(np.median(series.values[:BASELINE]))
            relative = quantity.effect != "offset" and reference != 0.0
            scale = 100.0 / abs(reference) if relative else 1.0
            lines[quantity.joint] = scale * (series.values - reference)
            unit = "%" if relative else arm.units[quantity]
    return f"{name}: change from the first nights, {unit}", lines


ARM_SECTIONS_FROM = 5  # number of the first arm's section in the page


def fleet_report(history: History) -> str:
    """Return the report as one self-contained HTML page."""
    arms, alarms = list(read_arms(history)), read_alarms(history)
    links = {arm.serial: f"section-{k}" for k, arm in enumerate(arms, start=ARM_SECTIONS_FROM)}
    active = [alarm for alarm in alarms if alarm.closed is None]
    ((first, last),) = history.rows("SELECT min(date), max(date) FROM runs WHERE status = 'done'")
    count = len({alarm.serial for alarm in active})
    state = f"{count} of them {'has' if count == 1 else 'have'} changed"
    state = state if count else "no arm has changed significantly"
    sentence = f"{len(arms)} arms, nights {first} to {last}: {state}."
    sections = [
        table_section("", alarm_table(active), sentences=[sentence], links=links),
        table_section(
            "All arms", arm_table(arms, active), outlier_table(outliers(history)), links=links
        ),
        table_section("Recordings that cannot be used", recording_table(history), links=links),
        table_section("Acknowledged alarms", closed_table(alarms), links=links, folded=True),
    ]
    pages = [
        _arm_section(history, arm, [a for a in alarms if a.serial == arm.serial]) for arm in arms
    ]
    return render("Fleet", [*sections, *pages])


def alarm_table(alarms: Sequence[Alarm], *, with_action: bool = True) -> Table:
    """Return the open alarms, the most severe first, with or without suggested actions."""
    headings = (
        "serial", "joint", "quantity", "change", "±", "unit", "since", "torque", "limit on",
        *(["suggested action"] if with_action else []),
    )  # fmt: skip
    rows = [
        (
            a.serial, a.joint, a.quantity, a.change,
            None if a.std is None else f"{a.std:.2g}", "" if a.unit == "1" else a.unit,
            a.since, f"{100 * a.severity:.1f} %",
            a.limit_date and f"{a.limit_date} ({a.limit_early} to {a.limit_late or 'later'})",
            *([a.action] if with_action else []),
        )
        for a in alarms
    ]  # fmt: skip
    return make_table(
        "Alarms",
        headings,
        rows,
        note="Torque: RMS of the torque that the fit no longer predicts over RMS of the measured "
        "torque, of the joint where it is largest; the table is sorted by it. The change is that "
        "of the last night; of an error it is relative.",
    )


def arm_table(arms: Sequence[ArmHistory], alarms: Sequence[Alarm]) -> Table:
    """Return one row per arm."""
    rows = []
    counts = Counter(alarm.serial for alarm in alarms)
    for arm in arms:
        errors = [(s.values[-1], q.joint) for q, s in arm.series.items() if q.name == ERROR]
        worst, joint = max(errors, default=(None, None))
        ratio = None if worst is None else float(np.exp(worst))
        nights = len(arm.dates), arm.dates[-1]
        rows.append((arm.serial, arm.robot, *nights, ratio, joint, counts[arm.serial] or None))
    rows.sort(key=lambda row: (-(row[6] or 0), -(row[4] or 0.0), row[0]))
    return make_table(
        "All arms",
        ("serial", "robot", "nights", "last night", "error / expected", "joint", "alarms"),
        rows,
        note="Error over expected: of the last night, of the joint where it is largest; expected "
        "of noise, of dry friction at reversals and of uncertain parameters.",
    )


def recording_table(history: History) -> Table:
    """Return recordings that were refused or failed."""
    refused = history.rows(
        "SELECT serial, date, recording, status, reason FROM runs WHERE status <> 'done' "
        "ORDER BY date DESC, serial"
    )
    return make_table(
        "Refused or failed", ("serial", "night", "recording", "status", "reason"), refused,
        note="Refused: the recording cannot be used. Failed: the next run tries it again.",
    )  # fmt: skip


def closed_table(alarms: Sequence[Alarm]) -> Table:
    """Return the acknowledged alarms."""
    headings = ("serial", "joint", "quantity", "since", "closed", "note", "change")
    closed = [a for a in alarms if a.closed is not None]
    rows = [(a.serial, a.joint, a.quantity, a.since, a.closed, a.note, a.sentence) for a in closed]
    return make_table("Acknowledged", headings, rows)


def _arm_section(history: History, arm: ArmHistory, alarms: Sequence[Alarm]) -> Section:
    note = " ".join(advice(history, alarm) for alarm in alarms if alarm.closed is None)
    picture = {
        "uri": data_uri(plot_trends(arm, alarms), dpi=80.0, colors=64),
        "alt": f"trends of {arm.serial}",
        "note": note or "No open alarm.",
    }
    title = f"{arm.serial} ({arm.robot})"
    return Section(title, "picture.html", picture, folded=not note)
