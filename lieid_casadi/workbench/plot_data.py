"""Signals of one joint along one recording, as the plots show them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison.error_plots import binned_mean, intervals
from lieid_casadi.comparison.plot_style import envelope, thin
from lieid_casadi.comparison.time_series import Series
from lieid_casadi.workbench.computing.results import Evaluation

Array = NDArray[np.float64]
MOST_SAMPLES = 350  # of one direction in a plot of the error
Line = list[list[float | None]]  # [time, value] pairs; a pair of None interrupts the line


@dataclass(frozen=True)
class TorqueLines:
    """Lines of the torque plot in a time window, N·m over s."""

    measured: Line
    predicted: Line
    error: Line


def series_of(evaluation: Evaluation, title: str) -> list[Series]:
    """Return the series of one recording, in the order of time."""
    parts = [c.series for c in (evaluation.train, evaluation.test) if c is not None]
    return [
        series
        for comparison in parts
        for series in comparison
        if series.recording == title or series.recording.startswith(f"{title}@")
    ]


def torque_lines(
    series: list[Series], joint: int, window: tuple[float, float], columns: int
) -> TorqueLines:
    """Return measured and predicted torque and error of a joint, decimated by minimum and maximum.

    Parameters
    ----------
    series : list of Series
    joint : int
        From 0.
    window : (float, float)
        First and last time, s.
    columns : int
        Pixels of the plot.
    """
    lines: dict[str, Line] = {"measured": [], "predicted": [], "error": []}
    for s in series:
        first, last = np.searchsorted(s.time, window)
        part = slice(max(int(first) - 1, 0), int(last) + 1)
        if s.time[part].size == 0:
            continue
        for name, values in (
            ("measured", s.measured),
            ("predicted", s.predicted),
            ("error", s.error),
        ):
            if lines[name]:
                lines[name].append([None, None])
            lines[name] += pairs(*envelope(s.time[part], values[part, joint], columns))
    return TorqueLines(**lines)


def pairs(x: Array, y: Array) -> Line:
    """Return points as a list, rounded to what a plot resolves."""
    return np.column_stack([np.round(x, 4), np.round(y, 5)]).tolist()  # type: ignore[no-any-return]


@dataclass(frozen=True)
class ErrorOverSignal:
    """Error of one joint over one signal: samples and means, forward and backward apart.

    Attributes
    ----------
    title, unit : str
        Of the signal.
    forward, backward, rest : Line
        Samples, evenly thinned.
    forward_mean, backward_mean : Line
        Means over intervals of the signal.
    """

    title: str
    unit: str
    forward: Line
    backward: Line
    rest: Line
    forward_mean: Line
    backward_mean: Line


def errors_over_signals(
    series: list[Series],
    joint: int,
    window: tuple[float, float] | None,
    *,
    revolute: bool = True,
    degrees: bool = False,
) -> list[ErrorOverSignal]:
    """Return the error over angle, speed, load, time, and temperature where it was recorded.

    Parameters
    ----------
    series : list of Series
    joint : int
        From 0.
    window : (float, float) or None
        Range of time, s; None for all of it.
    revolute, degrees : bool
        Whether angles are those of a joint that turns, in degrees.
    """
    parts = [_rows(s, window) for s in series]

    def joined(name: str) -> Array:
        return np.concatenate([getattr(s, name)[rows, joint] for s, rows in parts])

    if not parts or not sum(rows.stop - rows.start for _, rows in parts):
        return []
    error, sign = joined("error"), joined("sign")
    scale = np.degrees(1.0) if degrees and revolute else 1.0
    angle = ("°" if degrees else "rad") if revolute else "m"
    signals = [
        ("angle" if revolute else "position", angle, scale * joined("q")),
        ("speed", f"{angle}/s", scale * joined("dq")),
        ("load", "N·m" if revolute else "N", joined("load")),
        ("time", "s", np.concatenate([s.time[rows] for s, rows in parts])),
    ]
    if all(s.temperature is not None for s, _ in parts):
        signals.append(("temperature", "°C", joined("temperature")))
    return [_over(title, unit, values, error, sign) for title, unit, values in signals]


def _rows(series: Series, window: tuple[float, float] | None) -> tuple[Series, slice]:
    first, last = (0, len(series.time)) if window is None else np.searchsorted(series.time, window)
    return series, slice(int(first), int(last))


def _over(title: str, unit: str, signal: Array, error: Array, sign: Array) -> ErrorOverSignal:
    edges = intervals(signal, around_zero=title == "speed")

    def samples(direction: float) -> Line:
        use = thin(sign == direction, MOST_SAMPLES)
        return pairs(signal[use], error[use])

    def means(direction: float) -> Line:
        here = sign == direction
        centre, mean = binned_mean(signal[here], error[here], edges)
        return [[x, y] for x, y in pairs(centre, mean) if y == y]

    return ErrorOverSignal(
        title, unit, samples(1.0), samples(-1.0), samples(0.0), means(1.0), means(-1.0)
    )
