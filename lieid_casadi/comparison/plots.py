"""Plots of errors: over time, over the signals that they may depend on, of successive models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill

import numpy as np

from lieid_casadi import plot_style
from lieid_casadi.arrays import Array
from lieid_casadi.comparison.series import Series
from lieid_casadi.plot_style import Axes, Figure

FEWEST_INTERVALS, MOST_INTERVALS = 6, 16
PER_INTERVAL = 40  # samples, if that gives more than the fewest intervals
FEWEST_SAMPLES = 5  # of an interval with a mean
FEW_POINTS = 600  # up to this number, points are drawn larger
SHOWN = 99.5  # per cent of the errors that are inside the axes
LONGEST_NAME = 22  # characters of a joint's name
LABEL_WIDTH = 30  # characters of a line of the legend
DIRECTIONS = ((1.0, plot_style.FORWARD), (-1.0, plot_style.BACKWARD), (0.0, plot_style.REST))


@dataclass(frozen=True)
class JointLabel:
    """What the plots of one joint state: its name, the unit and size of its error, its noise."""

    name: str
    unit: str
    error: str
    noise_floor: float


def plot_torques(series: Sequence[Series], labels: Sequence[JointLabel]) -> Figure:
    """Plot one row per joint: torques on the left, the error on its own scale on the right."""
    n = len(labels)
    figure = plot_style.new_figure(13.0, 0.9 + 1.65 * n)
    axes = figure.subplots(n, 2, sharex=True, squeeze=False, width_ratios=(3, 2))
    for joint, label in enumerate(labels):
        torque, error = axes[joint]
        _draw_torque(series, joint, torque)
        floor = label.noise_floor if np.isfinite(label.noise_floor) else 0.0
        error.axhspan(-floor, floor, color=plot_style.NOISE, linewidth=0.0, zorder=0.5)
        _draw_error(series, joint, error)
        plot_style.title(torque, f"joint {label.name}")
        plot_style.title(error, label.error)
        plot_style.label(torque, y=f"τ [{label.unit}]")
    for ax in axes[-1]:
        plot_style.label(ax, x=_clock(series)[1])
    handles = [*axes[0, 0].get_lines()[:2], *axes[0, 1].get_lines()[:1]]
    names = ["measured", "predicted", "error = measured − predicted"]
    if any(np.isfinite(label.noise_floor) for label in labels):
        handles.append(axes[0, 1].patches[0])
        names.append("± noise floor")
    figure.legend(
        handles, names, loc="outside upper left", ncols=4, frameon=False, fontsize=plot_style.NORMAL
    )
    return figure


def plot_joint(
    series: Sequence[Series], joint: int, label: JointLabel, ax: Axes | None = None
) -> Figure:
    """Plot measured torque, predicted torque and error of one joint (from 0)."""
    figure, ax = plot_style.drawing(ax, 9.0, 3.2)
    _draw_torque(series, joint, ax)
    _draw_error(series, joint, ax)
    plot_style.title(ax, f"joint {label.name}: {label.error}")
    plot_style.label(ax, x=_clock(series)[1], y=f"τ [{label.unit}]")
    lines = ax.get_lines()[-3 * len(series) :]
    handles, names = (
        [lines[0], lines[1], lines[2 * len(series)]],
        ["measured", "predicted", "error"],
    )
    ax.legend(handles, names, loc="best", ncols=3, fontsize=plot_style.SMALL, framealpha=0.8)
    return figure


def _clock(series: Sequence[Series]) -> tuple[list[Array], str]:
    return plot_style.axis_times([s.recording for s in series], [s.time for s in series])


def _draw_torque(series: Sequence[Series], joint: int, ax: Axes) -> None:
    plot_style.style(ax)
    for each, time in zip(series, _clock(series)[0], strict=True):
        for values, colour, width in (
            (each.measured, plot_style.MEASURED, 2.4),
            (each.predicted, plot_style.PREDICTED, 0.9),
        ):
            x, y = plot_style.envelope(time, values[:, joint])
            ax.plot(x, y, color=colour, linewidth=width)


def _draw_error(series: Sequence[Series], joint: int, ax: Axes) -> None:
    plot_style.style(ax)
    for each, time in zip(series, _clock(series)[0], strict=True):
        x, y = plot_style.envelope(time, each.error[:, joint])
        ax.plot(x, y, color=plot_style.ERROR, linewidth=0.8)


SIGNALS = ("position q", "speed q̇", "load τ_load (rigid torque)", "time")


def plot_errors(series: Sequence[Series], labels: Sequence[JointLabel]) -> Figure:
    """Plot one row per joint and one column per signal.

    Points are samples, coloured by the direction of motion; thick lines are means over intervals
    of the signal (over time, of both directions); the band is the noise floor. If friction grows
    with load, the distance between the two lines grows with the load; an error of inertia or
    gravity changes both lines in the same way.
    """
    figure = plot_style.new_figure(14.0, 0.9 + 1.9 * len(labels))
    axes = figure.subplots(len(labels), len(SIGNALS), sharey="row", squeeze=False)
    times, clock = _clock(series)
    for joint, label in enumerate(labels):
        _draw_row(series, joint, label, axes[joint], np.concatenate(times))
    for ax, text in zip(axes[0], SIGNALS, strict=True):
        plot_style.title(ax, text)
    plot_style.label(axes[-1, -1], x=clock)
    names = ["moving forward", "moving backward", "at rest"]
    handles = [*axes[0, 0].get_lines()[:3][::-1]]  # drawn in the reverse order
    if any(np.isfinite(label.noise_floor) for label in labels):
        handles, names = [*handles, *axes[0, 0].patches[:1]], [*names, "± noise floor"]
    figure.legend(
        handles, names, title="error = measured − predicted; lines: mean of each interval",
        title_fontsize=plot_style.NORMAL, loc="outside upper left", alignment="left", ncols=4,
        frameon=False, fontsize=plot_style.NORMAL, markerscale=3.0,
    )  # fmt: skip
    return figure


def _draw_row(
    series: Sequence[Series], joint: int, label: JointLabel, axes: Array, time: Array
) -> None:
    turns = label.unit != "N"
    error, sign, q, dq, load = (
        np.concatenate([getattr(s, name)[:, joint] for s in series])
        for name in ("error", "sign", "q", "dq", "load")
    )
    floor = label.noise_floor
    limit = max(float(np.percentile(np.abs(error), SHOWN)), 0.0) or 1.0
    for ax, signal in zip(axes, (q, dq, load, time), strict=True):
        plot_style.style(ax)
        if np.isfinite(floor):
            ax.axhspan(-floor, floor, color=plot_style.NOISE, linewidth=0.0, zorder=0.5)
        _draw_samples(ax, signal, error, sign)
        ax.axhline(0.0, color=plot_style.TEXT, linewidth=0.6, zorder=0.6)
        edges = intervals(signal, around_zero=signal is dq)
        for way, colour in DIRECTIONS[:2] if signal is not time else ((None, plot_style.TEXT),):
            here = np.ones(len(sign), dtype=bool) if way is None else sign == way
            ax.plot(
                *binned_mean(signal[here], error[here], edges),
                "-o", color=colour, linewidth=1.8, markersize=2.5, zorder=3,
            )  # fmt: skip
    axes[0].set_ylim(-1.1 * limit, 1.1 * limit)
    name = plot_style.plain(plot_style.shortened(label.name, LONGEST_NAME))
    plot_style.label(axes[0], x="rad" if turns else "m", y=f"joint {name}\nerror [{label.unit}]")
    plot_style.label(axes[1], x="rad/s" if turns else "m/s")
    plot_style.label(axes[2], x=label.unit)


def _draw_samples(ax: Axes, signal: Array, error: Array, sign: Array) -> None:
    size = 3.0 if len(error) > FEW_POINTS else 5.0
    for direction, colour in reversed(DIRECTIONS):
        use = plot_style.thin(sign == direction)
        ax.plot(
            signal[use], error[use], ".", color=colour, alpha=0.4, markersize=size, mew=0.0,
            rasterized=True, zorder=1.5,
        )  # fmt: skip


def intervals(signal: Array, *, around_zero: bool = False) -> Array:
    """Return the limits (B + 1,) of equal intervals over 99 % of a signal's values."""
    low, high = (float(x) for x in np.percentile(signal, [0.5, 99.5]))
    count = int(np.clip(len(signal) // PER_INTERVAL, FEWEST_INTERVALS, MOST_INTERVALS))
    if not (around_zero and low < 0.0 < high):
        return np.linspace(low, high, count + 1)
    below = max(1, round(count * -low / (high - low)))
    above = max(1, count - below)
    return np.concatenate([np.linspace(low, 0.0, below + 1), np.linspace(0.0, high, above + 1)[1:]])


def binned_mean(x: Array, y: Array, edges: Array) -> tuple[Array, Array]:
    """Return the centre of each interval (B,) and the mean of y in it, NaN with few samples."""
    count, _ = np.histogram(x, edges)
    total, _ = np.histogram(x, edges, weights=y)
    mean = np.where(count >= FEWEST_SAMPLES, total / np.maximum(count, 1), np.nan)
    return (edges[1:] + edges[:-1]) / 2.0, mean


def draw_errors(
    series: Sequence[Array],
    labels: Sequence[str],
    reference: tuple[str, Array] | None,
    recordings: str,
    ax: Axes | None = None,
) -> Figure:
    """Draw the errors (n,) of successive models relative to the first one, joint by joint."""
    from matplotlib import colormaps

    colours = colormaps["viridis"]
    joints = len(series[0]) if series else 0
    figure, ax = plot_style.drawing(ax, 3.6 + 1.2 * joints, 3.6)
    width = 0.8 / max(len(series), 1)
    for k, values in enumerate(series):
        at = np.arange(joints) - 0.4 + (k + 0.5) * width
        colour = "0.6" if k == 0 else colours(0.15 + 0.75 * k / len(series))
        label = fill(labels[k], LABEL_WIDTH, break_long_words=False)
        ax.bar(at, values / series[0], width, label=label, color=colour)
    name, values = reference or ("", np.zeros(0))
    if series:
        for j, part in enumerate(values / series[0][: len(values)]):
            ax.plot([j - 0.4, j + 0.4], [part, part], "k--", linewidth=1.0)
    ax.set_xticks(range(joints), [f"{j + 1}" for j in range(joints)])
    ax.set_xlabel(f"joint (dashed: {name})" if name else "joint")
    ax.set_ylabel(f"RMS error on the {recordings}\nfirst model = 1".replace(", ", ",\n"))
    ax.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure
