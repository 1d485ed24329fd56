"""Trends of one arm: friction and errors of all joints over the nights, and the temperature."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison.plot_style import ERROR as ERROR_COLOUR
from lieid_casadi.comparison.plot_style import GRID, SMALL, new_figure, title
from lieid_casadi.fleet.alarm import Alarm
from lieid_casadi.fleet.arm_history import ERROR, ArmHistory, Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BASELINE = 3  # nights whose median is the reference of relative changes
MOST_EFFECTS = 3  # panels of coefficients


def plot_trends(arm: ArmHistory, alarms: Sequence[Alarm], since: date | None = None) -> Figure:
    """Draw each effect's first coefficient, the errors, and the temperature over the nights.

    Parameters
    ----------
    arm : ArmHistory
    alarms : sequence of Alarm
        Of the arm: the first night of each is marked.
    since : date, optional
        First night that is drawn.
    """
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
