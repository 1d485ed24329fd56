"""Common style of all plots: colours, axes, decimation; Matplotlib's settings are not changed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.arrays import Array, Indices, Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:
    Axes = Figure = object  # for annotations: Matplotlib is imported when something is drawn

# Okabe and Ito's colours, distinguishable for colour-blind readers
MEASURED, PREDICTED, ERROR = "#a3a9ae", "#0b4f8a", "#c44e00"
FORWARD, BACKWARD, REST = "#0072b2", "#d55e00", "#8a8a8a"
NOISE, GRID, TEXT = "#cfd8dc", "#e3e6e8", "#333333"
SMALL, NORMAL = 8.0, 9.0  # pt

MOST_COLUMNS = 1500  # of a line, pixels
MOST_POINTS = 2500  # of one colour in a scatter plot


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure without a window; width and height in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained", facecolor="white")


def drawing(ax: Axes | None, width: float, height: float) -> tuple[Figure, Axes]:
    """Return axes, new ones if None are given, and their figure, also if in a subfigure."""
    from matplotlib.figure import Figure

    if ax is None:
        ax = new_figure(width, height).subplots()
    figure = ax.figure
    while not isinstance(figure, Figure):
        figure = figure.figure
    return figure, ax


def style(ax: Axes) -> None:
    """Apply the common style to axes."""
    ax.set_facecolor("white")
    ax.grid(True, color=GRID, linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color("#9aa0a6")
        ax.spines[side].set_linewidth(0.8)
    ax.locator_params(nbins=6)
    ax.tick_params(labelsize=SMALL, colors=TEXT, length=3.0, width=0.8)


def title(ax: Axes, text: str) -> None:
    """Set the title of axes, aligned left."""
    ax.set_title(plain(text), loc="left", fontsize=NORMAL, color=TEXT, pad=3.0)


def label(ax: Axes, *, x: str = "", y: str = "") -> None:
    """Set the labels of the axes, quantity and unit; an empty one stays."""
    if x:
        ax.set_xlabel(x, fontsize=SMALL, color=TEXT)
    if y:
        ax.set_ylabel(y, fontsize=SMALL, color=TEXT)


def plain(text: str) -> str:
    """Return text with ``$`` escaped: names from files are not mathematical expressions."""
    return text.replace("$", r"\$")


def shortened(text: str, most: int) -> str:
    """Return text of at most ``most`` characters."""
    return text if len(text) <= most else text[: most - 1] + "…"


def envelope(x: Array, y: Array, columns: int = MOST_COLUMNS) -> tuple[Array, Array]:
    """Decimate a line (N,) for drawing; keep the smallest and largest value of each interval."""
    if len(x) <= 2 * columns:
        return x, y
    length = -(-len(x) // columns)
    first = np.arange(0, len(x), length)
    filled = np.pad(y, (0, len(first) * length - len(y)), mode="edge").reshape(-1, length)
    keep = np.unique(np.concatenate([first + filled.argmin(axis=1), first + filled.argmax(axis=1)]))
    return x[keep], y[keep]


def thin(marked: Mask, most: int = MOST_POINTS) -> Indices:
    """Return positions of marked samples, evenly decimated to at most ``most``."""
    found = np.flatnonzero(marked)
    return found[:: max(1, -(-len(found) // most))]


def axis_times(recordings: Sequence[str], times: Sequence[Array]) -> tuple[list[Array], str]:
    """Return the times of each segment, s, on one axis, and the label of the axis."""
    if len(set(recordings)) <= 1:
        return list(times), "time [s]"
    span = sum(float(t[-1] - t[0]) for t in times)
    shifted, start, previous = [], 0.0, None
    for name, t in zip(recordings, times, strict=True):
        if previous is not None and name == previous[0]:
            start += float(t[0] - previous[1])
        elif previous is not None:
            start += 0.02 * span
        shifted.append(t - t[0] + start)
        start, previous = float(shifted[-1][-1]), (name, float(t[-1]))
    return shifted, "time, recordings one after another [s]"
