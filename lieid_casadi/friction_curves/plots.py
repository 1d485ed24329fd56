"""Plots of friction over speed, coloured by load."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lieid_casadi import plot_style
from lieid_casadi.arrays import Array
from lieid_casadi.plot_style import Axes, Figure

COLOURS = "viridis"
LINES = 3


def plot_friction(
    points: tuple[Array, Array, Array, Array],
    unit: str,
    title: str,
    *,
    model: Callable[[Array, float], Array] | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw speeds, friction, standard errors and loads (G,) as points; return the figure."""
    speed, friction, std, load = points
    figure, ax = plot_style.drawing(ax, 7.0, 4.2)
    plot_style.style(ax)
    ax.errorbar(speed, friction, std, fmt="none", ecolor=plot_style.MEASURED, zorder=2)
    cloud = ax.scatter(speed, friction, c=load, cmap=COLOURS, s=16, zorder=3, vmin=0.0)
    bar = figure.colorbar(cloud, ax=ax)
    bar.set_label(f"|τ_load| [{unit}]", fontsize=plot_style.SMALL)
    bar.ax.tick_params(labelsize=plot_style.SMALL)
    if model is not None:
        drawn = np.geomspace(speed.min(), speed.max(), 200)
        for each in np.linspace(load.min(), load.max(), LINES):
            ax.plot(drawn, model(drawn, each), color=cloud.to_rgba(each), linewidth=1.2)
    plot_style.title(ax, title)
    speed_unit = "rad/s" if unit == "N·m" else "m/s"
    plot_style.label(ax, x=f"|q̇| [{speed_unit}]", y=f"friction [{unit}]")
    ax.autoscale(True)
    ax.set_xlim(left=0.0)
    if friction.min() > 0.0:
        ax.set_ylim(bottom=0.0)
    return figure
