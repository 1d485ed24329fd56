"""Plots of friction over speed, coloured by load."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.comparison import plot_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.friction_curves.agreement import FrictionAgreement
    from lieid_casadi.friction_curves.curve import FrictionCurve
    from lieid_casadi.friction_curves.friction_fit import FrictionFit

COLOURS = "viridis"
ONE_LOAD = 0.2  # range of loads, relative to the largest, below which one colour is used
LINES = 3


def plot_curve(curve: FrictionCurve, ax: Axes | None = None) -> Figure:
    """Draw the points with their standard errors and return the figure."""
    if ax is None:
        ax = plot_style.new_figure(7.0, 4.2).subplots()
    plot_style.style(ax)
    ax.errorbar(
        curve.speed, curve.friction, curve.std, fmt="none", ecolor=plot_style.MEASURED, zorder=2
    )
    if _loads_differ(curve):
        cloud = ax.scatter(
            curve.speed, curve.friction, c=curve.load, cmap=COLOURS, s=16, zorder=3, vmin=0.0
        )
        bar = plot_style.root_figure(ax).colorbar(cloud, ax=ax)
        bar.set_label(f"|τ_load| [{curve.unit}]", fontsize=plot_style.SMALL)
        bar.ax.tick_params(labelsize=plot_style.SMALL)
    else:
        ax.scatter(curve.speed, curve.friction, color=plot_style.FORWARD, s=16, zorder=3)
    plot_style.title(
        ax, f"joint {curve.joint + 1} {curve.joint_name}: half of forward − backward torque"
    )
    speed = "rad/s" if curve.unit == "N·m" else "m/s"
    plot_style.label(ax, x=f"|q̇| [{speed}]", y=f"friction [{curve.unit}]")
    _from_zero(ax, curve)
    return plot_style.root_figure(ax)


def plot_fit(fit: FrictionFit, ax: Axes | None = None) -> Figure:
    """Draw the points, and the model as lines at loads from smallest to largest."""
    import matplotlib

    if ax is None:
        ax = plot_style.new_figure(7.0, 4.2).subplots()
    curve = fit.curve
    figure = plot_curve(curve, ax)
    speed = np.geomspace(curve.speed.min(), curve.speed.max(), 200)
    top = max(float(curve.load.max()), 1e-12)
    loads = [float(curve.load.mean())]
    if _loads_differ(curve):
        loads = list(np.linspace(curve.load.min(), curve.load.max(), LINES))
    for load in loads:
        colour = (
            matplotlib.colormaps[COLOURS](load / top) if len(loads) > 1 else plot_style.PREDICTED
        )
        ax.plot(speed, fit.friction(speed, load=load), color=colour, linewidth=1.2)
    text = f"joint {curve.joint + 1} {curve.joint_name}: RMS {fit.rms:.3g} {curve.unit}"
    if np.isfinite(fit.correlation):
        text += f", correlation {fit.correlation:.3f}"
    plot_style.title(ax, f"{text}\n{', '.join(fit.effects)}")
    _from_zero(ax, curve)
    return figure


def _from_zero(ax: Axes, curve: FrictionCurve) -> None:
    """Start both axes at zero."""
    ax.autoscale(True)
    ax.set_xlim(left=0.0)
    if curve.friction.min() > 0.0:
        ax.set_ylim(bottom=0.0)


def _loads_differ(curve: FrictionCurve) -> bool:
    return bool(np.ptp(curve.load) > ONE_LOAD * curve.load.max(initial=0.0))


def plot_agreement(agreement: FrictionAgreement, ax: Axes | None = None) -> Figure:
    """Draw both determinations over speed with two standard deviations of their difference."""
    if ax is None:
        ax = plot_style.new_figure(7.0, 4.2).subplots()
    plot_style.style(ax)
    a = agreement
    ax.errorbar(
        a.speed, a.first, 2.0 * a.std, fmt="o", ms=4, color=plot_style.PREDICTED, label="first ± 2σ"
    )
    ax.plot(a.speed, a.second, "s", ms=4, color=plot_style.ERROR, label="second")
    ax.legend(fontsize=plot_style.SMALL, loc="best")
    plot_style.title(
        ax,
        f"joint {a.joint + 1}: {'agree' if a.agree else 'disagree'}, "
        f"differ by {100.0 * a.relative:.1f} %",
    )
    plot_style.label(ax, x="|q̇| [rad/s]", y="friction [N·m]")
    ax.set_xlim(left=0.0)
    return plot_style.root_figure(ax)
