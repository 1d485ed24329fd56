"""Figures of the unexplained residual: curves over one signal and maps over two."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.diagnosis.residual.shapes import SmoothShape
    from lieid_casadi.diagnosis.residual.unexplained import Unexplained

CONTOURS = 12


def plot_shapes(parts: Sequence[Unexplained], ax: Axes | None = None) -> Figure:
    """Draw the smooth functions of unexplained parts, one row for each part.

    With ``ax`` only the first function is drawn, into these axes.
    """
    from matplotlib.figure import Figure

    rows = [part.shapes for part in parts if part.shapes]
    if ax is not None:
        figure: Figure = ax.get_figure(root=True)  # type: ignore[assignment]
        if rows:
            draw_shape(rows[0][0], ax)
        return figure
    wide = max((len(row) for row in rows), default=1)
    high = max(len(rows), 1)
    figure = Figure(figsize=(4.6 * wide, 3.4 * high), layout="constrained")
    axes = figure.subplots(high, wide, squeeze=False)
    for k, places in enumerate(axes):
        for m, place in enumerate(places):
            if k < len(rows) and m < len(rows[k]):
                draw_shape(rows[k][m], place)
            else:
                place.set_axis_off()
    return figure


def plot_shape(shape: SmoothShape, ax: Axes | None = None) -> Figure:
    """Draw one smooth function."""
    from matplotlib.figure import Figure

    figure: Figure
    if ax is None:
        figure = Figure(figsize=(4.6, 3.4), layout="constrained")
        ax = figure.add_subplot()
    else:
        figure = ax.get_figure(root=True)  # type: ignore[assignment]
    draw_shape(shape, ax)
    return figure


def draw_shape(shape: SmoothShape, ax: Axes) -> None:
    """Draw a curve with its 95 % band, or a map of two signals."""
    ax.set_title(f"joint {shape.joint + 1}: unexplained torque, N·m", fontsize="medium")
    if len(shape.grid) == 1:
        (x,) = shape.grid
        ax.fill_between(x, shape.low, shape.high, color="tab:blue", alpha=0.25, linewidth=0.0)
        ax.plot(x, shape.value, color="tab:blue")
        ax.axhline(0.0, color="0.6", linewidth=0.8)
        ax.set_xlabel(f"{shape.signals[0]}, {shape.units[0]}")
        return
    _draw_map(shape, ax)


def _draw_map(shape: SmoothShape, ax: Axes) -> None:
    """Draw a map; regions that do not differ significantly from zero are hatched."""
    x, y = shape.grid
    value = np.ma.masked_invalid(shape.value.T)
    most = max(float(np.abs(value).max()) if value.count() else 0.0, 1e-12)
    levels = np.linspace(-most, most, CONTOURS + 1)
    drawn = ax.contourf(x, y, value, levels=levels, cmap="RdBu_r")
    unsure = np.ma.masked_invalid(np.where((shape.low < 0) & (shape.high > 0), 1.0, 0.0).T)
    unsure = np.ma.masked_where(np.ma.getmaskarray(value), unsure)
    ax.contourf(x, y, unsure, levels=[0.5, 1.5], colors="none", hatches=["..."])
    ax.set_xlabel(f"{shape.signals[0]}, {shape.units[0]}")
    ax.set_ylabel(f"{shape.signals[1]}, {shape.units[1]}")
    ax.figure.colorbar(drawn, ax=ax, format="%.2g")
