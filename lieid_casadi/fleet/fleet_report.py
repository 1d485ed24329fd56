"""The report of a fleet: alarms, all arms, suspicious recordings, and the trends of each arm."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison.plot_style import ERROR as ERROR_COLOUR
from lieid_casadi.comparison.plot_style import GRID, SMALL, new_figure, title
from lieid_casadi.fleet.alarms import Alarm, read_alarms, suggested_action
from lieid_casadi.fleet.arm_history import ERROR, ArmHistory, Quantity, read_arms
from lieid_casadi.fleet.history import History
from lieid_casadi.report import Section, data_uri, render
from lieid_casadi.report.page import table_section
from lieid_casadi.tables import Table, make_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


BASELINE = 3  # nights whose median is the reference of relative changes
MOST_EFFECTS = 3  # panels of coefficients


def plot_trends(arm: ArmHistory, alarms: Sequence[Alarm], since: date | None = None) -> Figure:
    """Draw each effect's first coefficient, the errors, the temperature and the alarms' nights."""
    names = _first_coefficients(arm)[:MOST_EFFECTS]
    warm = any(s.has_temperature for s in arm.series.values())
    figure = new_figure(9.5, 1.7 * (len(names) + 1 + warm) + 0.4)
    axes = figure.subplots(len(names) + 1 + warm, 1, sharex=True, squeeze=False)[:, 0]
    first = 0 if since is None else min(sum(d < since for d in arm.dates), len(arm.dates) - 1)
    nights = np.array(arm.dates[first:], dtype="datetime64[D]")
    for ax, name in zip(axes, names, strict=False):
        _draw_coefficient(ax, arm, name, first, nights)
    for joint in range(1, arm.joints + 1):
        series = arm.series.get(Quantity(ERROR, joint))
        if series is not None:
            axes[len(names)].plot(
                nights, np.exp(series.values[first:]), label=f"joint {joint}", **_line(joint)
            )
    _logarithmic(axes[len(names)])
    title(axes[len(names)], "error in motion / held-out error of the fit")
    if warm:
        _draw_temperature(axes[-1], arm, first, nights)
    for ax in axes:
        _style(ax)
        for alarm in alarms:
            if not len(nights) or alarm.since >= arm.dates[first]:
                ax.axvline(np.datetime64(alarm.since), color=ERROR_COLOUR, linewidth=1.0, alpha=0.7)
    axes[len(names)].legend(
        fontsize=SMALL, ncols=1, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False
    )
    return figure


def _style(ax: Axes) -> None:
    """Style axes whose x are dates."""
    ax.grid(True, linewidth=0.6, color=GRID)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=SMALL)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _logarithmic(ax: Axes) -> None:
    """Use a logarithmic scale with plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(ScalarFormatter())
    ax.yaxis.set_minor_formatter(NullFormatter())


def _first_coefficients(arm: ArmHistory) -> list[str]:
    """Return the name of the first coefficient of each effect."""
    names: dict[str, str] = {}
    for quantity in arm.series:
        if quantity.name != ERROR:
            names.setdefault(quantity.effect, quantity.name)
    return list(names.values())


def _draw_coefficient(
    ax: Axes, arm: ArmHistory, name: str, first: int, nights: NDArray[np.datetime64]
) -> None:
    for quantity, series in arm.series.items():
        if quantity.name != name:
            continue
        reference = float(np.median(series.values[:BASELINE]))
        change = series.values[first:] - reference
        relative = name.partition(".")[0] != "offset" and reference != 0.0
        shown = 100.0 * change / abs(reference) if relative else change
        ax.plot(nights, shown, **_line(quantity.joint))
        unit = "%" if relative else arm.units[quantity]
        title(ax, f"{name}: change from the first nights, {unit}")


def _draw_temperature(
    ax: Axes, arm: ArmHistory, first: int, nights: NDArray[np.datetime64]
) -> None:
    drawn = set()
    for quantity, series in arm.series.items():
        if quantity.joint not in drawn and np.isfinite(series.temperature).any():
            drawn.add(quantity.joint)
            ax.plot(nights, series.temperature[first:], **_line(quantity.joint))
    title(ax, "mean temperature, °C")


def _line(joint: int) -> dict[str, Any]:
    return {"color": f"C{(joint - 1) % 10}", "linewidth": 1.2, "marker": ".", "markersize": 3.0}


ARM_SECTIONS_FROM = 5  # number of the first arm's section in the page
#: Warnings that many nights of sound arms have. A sign that differs from that of the fit changes
#: the night's coefficients and errors, which are judged.
ORDINARY_CHECKS = (
    "FrictionAtRestWarning", "UnidentifiableWarning", "AliasWarning", "TorqueSignWarning",
)  # fmt: skip


def fleet_report(history: History, *, since: date | None = None) -> str:
    """Return the report as one self-contained HTML page, of nights since a first one."""
    arms, alarms = list(read_arms(history)), read_alarms(history)
    links = {arm.serial: f"section-{k}" for k, arm in enumerate(arms, start=ARM_SECTIONS_FROM)}
    active = [alarm for alarm in alarms if alarm.closed is None]
    nights = history.rows("SELECT min(date), max(date) FROM runs WHERE status = 'done'")[0]
    sections = [
        table_section(
            "", alarm_table(active), sentences=[_sentence(arms, active, nights)], links=links
        ),
        table_section("All arms", arm_table(arms, active), links=links),
        table_section(
            "Suspicious recordings", *recording_tables(history, since), titles=True, links=links
        ),
        table_section("Acknowledged alarms", closed_table(alarms), links=links, folded=True),
    ]
    pages = [
        _arm_section(arm, [a for a in alarms if a.serial == arm.serial], since) for arm in arms
    ]
    return render("Fleet", [*sections, *pages])


def alarm_table(alarms: Sequence[Alarm], *, with_action: bool = True) -> Table:
    """Return the open alarms, the most severe first, with or without suggested actions."""
    headings = ["serial", "joint", "quantity", "change", "±", "unit", "since", "torque", "limit on"]
    rows: list[list[object]] = [
        [
            a.serial, a.joint, a.quantity, a.change,
            None if a.std is None else f"{a.std:.2g}", "" if a.unit == "1" else a.unit,
            a.since, f"{100 * a.severity:.1f} %", a.limit_date,
        ]
        for a in alarms
    ]  # fmt: skip
    if with_action:
        headings.append("suggested action")
        rows = [[*row, suggested_action(a.quantity)] for row, a in zip(rows, alarms, strict=True)]
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
    for arm in arms:
        ratios = {
            q.joint: float(np.exp(s.values[-1])) for q, s in arm.series.items() if q.name == ERROR
        }
        worst = max(ratios, key=lambda j: ratios[j], default=None)
        count = sum(alarm.serial == arm.serial for alarm in alarms)
        rows.append(
            (
                arm.serial, arm.robot, len(arm.dates), arm.dates[-1],
                None if worst is None else ratios[worst], worst, count or None,
            )
        )  # fmt: skip
    rows.sort(key=lambda row: (-(row[6] or 0), -(row[4] or 0.0), row[0]))
    return make_table(
        "All arms",
        ("serial", "robot", "nights", "last night", "error / expected", "joint", "alarms"),
        rows,
        note="Error over expected: of the last night, of the joint where it is largest; expected "
        "is the held-out error of the fit.",
    )


def recording_tables(history: History, since: date | None) -> tuple[Table, Table]:
    """Return recordings that were refused or failed, and recordings with warnings."""
    first = since or date.min
    refused = history.rows(
        "SELECT serial, date, recording, status, reason FROM runs WHERE status <> 'done' "
        "AND date >= ? ORDER BY date DESC, serial",
        [first],
    )
    warned = history.rows(
        "SELECT serial, name, count(DISTINCT date), max(date), arg_max(message, date) FROM checks "
        "WHERE date >= ? AND NOT list_contains(?, name) GROUP BY serial, name "
        "ORDER BY max(date) DESC, serial, name",
        [first, list(ORDINARY_CHECKS)],
    )
    shown = [(serial, name.removesuffix("Warning"), *rest) for serial, name, *rest in warned]
    return (
        make_table(
            "Refused or failed", ("serial", "night", "recording", "status", "reason"), refused,
            note="Refused: the recording cannot be used. Failed: the next run tries it again.",
        ),
        make_table(
            "With warnings", ("serial", "warning", "nights", "last night", "its message"), shown
        ),
    )  # fmt: skip


def closed_table(alarms: Sequence[Alarm]) -> Table:
    """Return the acknowledged alarms."""
    return make_table(
        "Acknowledged",
        ("serial", "joint", "quantity", "since", "closed", "note", "change"),
        [
            (a.serial, a.joint, a.quantity, a.since, a.closed, a.note, a.sentence)
            for a in alarms
            if a.closed is not None
        ],
    )


def _sentence(
    arms: Sequence[ArmHistory], alarms: Sequence[Alarm], nights: tuple[date | None, date | None]
) -> str:
    count = len({alarm.serial for alarm in alarms})
    state = (
        "no arm has changed significantly"
        if not alarms
        else f"{count} of them {'has' if count == 1 else 'have'} changed"
    )
    return f"{len(arms)} arms, nights {nights[0]} to {nights[1]}: {state}."


def _arm_section(arm: ArmHistory, alarms: Sequence[Alarm], since: date | None) -> Section:
    own = [alarm for alarm in alarms if alarm.serial == arm.serial]
    active = [alarm for alarm in own if alarm.closed is None]
    note = " ".join(f"{a.sentence}. Action: {suggested_action(a.quantity)}." for a in active)
    figure = plot_trends(arm, own, since)
    return Section(
        f"{arm.serial} ({arm.robot})",
        "picture.html",
        {
            "uri": data_uri(figure, dpi=80.0, colors=64),
            "alt": f"trends of {arm.serial}",
            "note": note or "No open alarm.",
        },
        folded=not active,
    )
