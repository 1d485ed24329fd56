"""The shape of what stays unexplained: a curve over one signal, or a map over two, with bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.projected_residual import Remainder
from lieid_casadi.diagnosis.residual.unexplained import Unexplained, bases_of, product_of, ranges_of
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
CURVE, MAP = 81, 25  # points of a grid
NEIGHBOURS = 1  # cells around those where the arm has been that a map shows
COLUMN = {"q": "q", "dq": "dq", "ddq": "ddq", "load": "load", "temp": "temperature", "t": "time"}
UNITS = {"q": "rad", "dq": "rad/s", "ddq": "rad/s²", "load": "N·m", "temp": "°C", "t": "s"}


@dataclass(frozen=True, eq=False)
class SmoothShape:
    """A smooth function of one or two signals that explains part of a joint's residual.

    It is what the model's own columns cannot follow: a part that they could (a constant beside
    ``offset``, a line through zero beside ``viscous``) is not in it.

    Attributes
    ----------
    joint : int
        From 0.
    signals : tuple of str
        One or two columns, such as ``q3``.
    units : tuple of str
        Of each signal; temperatures are relative to the mean of the training recordings.
    grid : tuple of (G,)
        One per signal.
    value, low, high : (G,) or (G, H)
        N·m (N on a sliding joint); the band holds the function with 95 % at each point. NaN where
        the arm has not been.
    """

    joint: int
    signals: tuple[str, ...]
    units: tuple[str, ...]
    grid: tuple[Array, ...]
    value: Array
    low: Array
    high: Array

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON, joints from 1; null where the arm has not been."""
        return {
            "joint": self.joint + 1,
            "signals": list(self.signals),
            "units": list(self.units),
            "grid": [grid.tolist() for grid in self.grid],
            "value": _listed(self.value),
            "low": _listed(self.low),
            "high": _listed(self.high),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the curve with its band, or the map; not shown."""
        from lieid_casadi.diagnosis.residual.shape_plots import plot_shape

        return plot_shape(self, ax)


def split_column(name: str) -> tuple[str, int]:
    """Return a column's kind and its joint (from 0): ``dq3`` → ``dq``, 2; ``t`` → ``t``, 0."""
    kind = name.rstrip("0123456789")
    return kind, int(name[len(kind) :] or 1) - 1


def series(signals: SegmentSignals, name: str) -> Array:
    """Return a column (K,) along a segment."""
    kind, joint = split_column(name)
    return np.asarray(signals.values[COLUMN[kind]][:, joint])


def shapes_of(part: Unexplained, remainder: Remainder) -> tuple[SmoothShape, ...]:
    """Return the smooth functions that named a part's signals, all fitted together."""
    if not part.terms:
        return ()
    ranges = ranges_of(remainder.signals)
    blocks, columns = [], []
    for names in part.terms:
        along = [_functions(s, names, ranges) for s in remainder.signals]
        blocks.append(np.mean(np.concatenate(along), axis=0) if _centred(names) else 0.0)
        columns.append(remainder.columns(part.joint, along))
    estimate = remainder.fit(np.hstack(columns))
    shapes, first = [], 0
    for names, mean, own in zip(part.terms, blocks, columns, strict=True):
        here = slice(first, first + own.shape[1])
        first = here.stop
        grid = tuple(_grid(name, ranges, CURVE if len(names) == 1 else MAP) for name in names)
        points = _at(remainder.signals[0], names, grid, ranges) - mean
        value = points @ estimate.values[here]
        variance = np.einsum("ga,ab,gb->g", points, estimate.covariance[here, here], points)
        half = estimate.quantile * np.sqrt(np.maximum(variance, 0.0))
        form = tuple(len(g) for g in grid)
        unseen = ~_seen(remainder.signals, names, grid)
        value, low, high = (
            np.where(unseen, np.nan, x.reshape(form)) for x in (value, value - half, value + half)
        )
        units = tuple(_unit(name, remainder.revolute) for name in names)
        shapes.append(SmoothShape(part.joint, names, units, grid, value, low, high))
    return tuple(shapes)


def _centred(names: Sequence[str]) -> bool:
    """Whether a constant is taken out of a function: friction and products are zero by nature."""
    return len(names) == 1 and not names[0].startswith("dq")


def _unit(name: str, revolute: Sequence[bool]) -> str:
    kind, joint = split_column(name)
    unit = UNITS[kind]
    return unit if revolute[joint] else unit.replace("N·m", "N").replace("rad", "m")


def _grid(name: str, ranges: dict[str, Array], count: int) -> Array:
    kind, joint = split_column(name)
    low, high = ranges[COLUMN[kind]][:, joint]
    grid = np.linspace(low, high, count)
    if kind == "dq" and low < 0.0 < high:  # both sides of zero, where dry friction jumps
        edge = 1e-6 * (high - low)
        grid = np.unique(np.concatenate([grid[np.abs(grid) > edge], [-edge, edge]]))
    return np.asarray(grid)


def _at(
    signals: SegmentSignals, names: Sequence[str], grid: Sequence[Array], ranges: dict[str, Array]
) -> Array:
    """Return the smooth functions (points, b) on the points of a grid, all others' values zero."""
    points = np.stack([g.ravel() for g in np.meshgrid(*grid, indexing="ij")])
    shape = (points.shape[1], signals.segment.n)
    values = {key: np.zeros(shape) for key in signals.values}
    for name, at in zip(names, points, strict=True):
        kind, joint = split_column(name)
        values[COLUMN[kind]][:, joint] = at
    values["sign"] = np.sign(values["dq"])
    return _functions(replace(signals, values=values), tuple(names), ranges)


def _functions(signals: SegmentSignals, names: tuple[str, ...], ranges: dict[str, Array]) -> Array:
    """Return the smooth functions (K, b) of one or two columns.

    Waves that are level at the ends of an angle's range need a parabola beside them: few of them
    bend otherwise.
    """
    functions = product_of(bases_of(signals, ranges), names)
    if len(names) > 1 or split_column(names[0])[0] != "q":
        return functions
    low, high = ranges["q"][:, split_column(names[0])[1]]
    half = max(0.5 * float(high - low), 1e-9)
    x = np.clip((series(signals, names[0]) - 0.5 * (low + high)) / half, -1.2, 1.2)
    return np.column_stack([functions, x, x**2])


def _seen(
    signals: Sequence[SegmentSignals], names: Sequence[str], grid: Sequence[Array]
) -> NDArray[np.bool_]:
    """Mark the points of a grid near which the arm has been."""
    seen = np.zeros([len(g) for g in grid], dtype=bool)
    if len(names) == 1:
        return ~seen
    cells = []
    for name, g in zip(names, grid, strict=True):
        along = np.concatenate([series(s, name) for s in signals])
        cells.append(np.clip(np.searchsorted(0.5 * (g[1:] + g[:-1]), along), 0, len(g) - 1))
    rows, columns = cells
    for i in range(-NEIGHBOURS, NEIGHBOURS + 1):
        for j in range(-NEIGHBOURS, NEIGHBOURS + 1):
            at = np.clip(rows + i, 0, seen.shape[0] - 1), np.clip(columns + j, 0, seen.shape[1] - 1)
            seen[at] = True
    return seen


def _listed(values: Array) -> list[Any]:
    if values.ndim > 1:
        return [_listed(row) for row in values]
    return [float(v) if np.isfinite(v) else None for v in values]
