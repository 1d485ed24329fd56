"""Plots of measured torque, predicted torque and error over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.comparison import plot_style
from lieid_casadi.comparison.table import digits, joint_title, percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.comparison.comparison import Comparison


def plot_torques(comparison: Comparison) -> Figure:
    """Plot one row per joint: torques on the left, the error on its own scale on the right."""
    n = comparison.n
    figure = plot_style.new_figure(13.0, 0.9 + 1.65 * n)
    axes = figure.subplots(n, 2, sharex=True, squeeze=False, width_ratios=(3, 2))
    clock = _clock(comparison)[1]
    for joint in range(n):
        torque, error = axes[joint]
        _draw_torque(comparison, joint, torque)
        _draw_error(comparison, joint, error)
        plot_style.title(torque, _torque_title(comparison, joint))
        plot_style.title(error, _error_title(comparison, joint))
        plot_style.label(torque, y=f"τ [{comparison.units[joint]}]")
    for ax in axes[-1]:
        plot_style.label(ax, x=clock)
    handles = [*axes[0, 0].get_lines()[:2], *axes[0, 1].get_lines()[:1]]
    names = ["measured", "predicted", "error = measured − predicted"]
    if np.isfinite(comparison.noise_floor).any():
        handles.append(axes[0, 1].patches[0])
        names.append("± noise floor")
    figure.legend(
        handles, names, loc="outside upper left", ncols=4, frameon=False, fontsize=plot_style.NORMAL
    )
    return figure


def plot_joint(comparison: Comparison, joint: int, ax: Axes | None = None) -> Figure:
    """Plot measured torque, predicted torque and error of one joint.

    Parameters
    ----------
    comparison : Comparison
    joint : int
        From 0.
    ax : Axes, optional
        Axes to draw into; a new figure without a window if left out.
    """
    if ax is None:
        ax = plot_style.new_figure(9.0, 3.2).subplots()
    _draw_torque(comparison, joint, ax)
    _draw_error(comparison, joint, ax, noise=False)
    plot_style.title(ax, f"{_torque_title(comparison, joint)}: {_error_title(comparison, joint)}")
    plot_style.label(ax, x=_clock(comparison)[1], y=f"τ [{comparison.units[joint]}]")
    count = len(comparison.series)
    lines = ax.get_lines()[-3 * count :]
    ax.legend(
        [lines[0], lines[1], lines[2 * count]],
        ["measured", "predicted", "error"],
        loc="best",
        ncols=3,
        fontsize=plot_style.SMALL,
        framealpha=0.8,
    )
    return plot_style.root_figure(ax)


def _clock(comparison: Comparison) -> tuple[list[plot_style.Array], str]:
    series = comparison.series
    return plot_style.axis_times([s.recording for s in series], [s.time for s in series])


def _draw_torque(comparison: Comparison, joint: int, ax: Axes) -> None:
    plot_style.style(ax)
    for series, time in zip(comparison.series, _clock(comparison)[0], strict=True):
        for values, colour, width in (
            (series.measured, plot_style.MEASURED, 2.4),
            (series.predicted, plot_style.PREDICTED, 0.9),
        ):
            x, y = plot_style.envelope(time, values[:, joint])
            ax.plot(x, y, color=colour, linewidth=width)


def _draw_error(comparison: Comparison, joint: int, ax: Axes, *, noise: bool = True) -> None:
    plot_style.style(ax)
    floor = comparison.noise_floor[joint]
    if noise:
        size = floor if np.isfinite(floor) else 0.0
        ax.axhspan(-size, size, color=plot_style.NOISE, linewidth=0.0, zorder=0.5)
    for series, time in zip(comparison.series, _clock(comparison)[0], strict=True):
        x, y = plot_style.envelope(time, series.error[:, joint])
        ax.plot(x, y, color=plot_style.ERROR, linewidth=0.8)


def _torque_title(comparison: Comparison, joint: int) -> str:
    return f"joint {joint_title(comparison, joint)}"


def _error_title(comparison: Comparison, joint: int) -> str:
    unit = comparison.units[joint]
    moving, relative = comparison.rms_moving[joint], comparison.relative_rms_moving[joint]
    if np.isnan(moving):
        return f"at rest: RMS {digits(comparison.rms[joint])} {unit}"
    text = f"in motion: RMS {digits(moving)} {unit}"
    if np.isfinite(relative):
        text += f", {percent(relative)} of the torque"
    if np.isfinite(comparison.noise_floor[joint]):
        text += f"; noise floor {digits(comparison.noise_floor[joint])}"
    return text
