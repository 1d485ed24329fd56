"""Shape of the unexplained residual: a curve over one signal or a map over two, with bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.projected_residual import ColumnEstimate, ProjectedResidual
from lieid_casadi.diagnosis.residual.signal_names import (
    SIGNAL_KEYS,
    signal_unit,
    signal_values,
    split_name,
)
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals
from lieid_casadi.diagnosis.screening.smooth_functions import (
    SignalRanges,
    basis_functions,
    has_memory,
    product_basis,
    signal_ranges,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.diagnosis.residual.unexplained import Unexplained

Array = NDArray[np.float64]
CURVE_POINTS, MAP_POINTS = 81, 25  # of a grid, along each signal
NEIGHBOURS = 1  # cells around a visited one that a map shows


@dataclass(frozen=True, eq=False)
class SmoothShape:
    """A smooth function of one or two signals that explains part of a joint's residual.

    Only the part outside the span of the model's columns is determined: a constant is zero
    if the model has ``offset``, as is a line through zero if it has ``viscous``.

    Attributes
    ----------
    joint : int
        From 0.
    signals : tuple of str
        One or two columns, such as ``q3``.
    units : tuple of str
        Of each signal; temperatures are relative to the mean of the training recordings.
    grid : tuple of (G,) arrays
        One per signal.
    value, low, high : (G,) or (G, H)
        In N·m, or N on a prismatic joint, with pointwise 95 % confidence limits. NaN where the
        recordings have no samples.
    """

    joint: int
    signals: tuple[str, ...]
    units: tuple[str, ...]
    grid: tuple[Array, ...]
    value: Array
    low: Array
    high: Array

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON, joints from 1; null where the recordings have no samples."""
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


def smooth_shapes(part: Unexplained, residual: ProjectedResidual) -> tuple[SmoothShape, ...]:
    """Return the smooth functions of an unexplained part, all fitted together.

    Those that depend on the past of a signal are fitted and have no shape.
    """
    if not part.terms:
        return ()
    ranges = signal_ranges(residual.signals)
    blocks, columns = [], []
    for names in part.terms:
        along = [_functions(s, names, ranges) for s in residual.signals]
        blocks.append(np.mean(np.concatenate(along), axis=0) if _centred(names) else 0.0)
        columns.append(residual.columns(part.joint, along))
    estimate = residual.fit(np.hstack(columns))
    shapes, first = [], 0
    for names, mean, own in zip(part.terms, blocks, columns, strict=True):
        here = slice(first, first + own.shape[1])
        first = here.stop
        if not has_memory(names):
            shapes.append(_shape(part.joint, names, mean, here, estimate, residual))
    return tuple(shapes)


def smooth_function(joint: int, names: tuple[str, ...], residual: ProjectedResidual) -> Array:
    """Return the columns (R, k) of the smooth functions of one or two signals on a joint.

    Parameters
    ----------
    joint : int
        From 0.
    names : tuple of str
    residual : ProjectedResidual
    """
    ranges = signal_ranges(residual.signals)
    return residual.columns(joint, [_functions(s, names, ranges) for s in residual.signals])


def _shape(
    joint: int,
    names: tuple[str, ...],
    mean: Array | float,
    columns: slice,
    estimate: ColumnEstimate,
    residual: ProjectedResidual,
) -> SmoothShape:
    """Return one fitted function with its band.

    Parameters
    ----------
    joint : int
        From 0.
    names : tuple of str
        One or two signals.
    mean : (b,) or float
        Subtracted from the basis functions.
    columns : slice
        Of the function among the estimated coefficients.
    estimate : ColumnEstimate
    residual : ColumnEstimate, ProjectedResidual
    """
    ranges = signal_ranges(residual.signals)
    count = CURVE_POINTS if len(names) == 1 else MAP_POINTS
    grid = tuple(_grid(name, ranges, count) for name in names)
    points = _at(residual.signals[0], names, grid, ranges) - mean
    value = points @ estimate.values[columns]
    variance = np.einsum("ga,ab,gb->g", points, estimate.covariance[columns, columns], points)
    half = estimate.quantile * np.sqrt(np.maximum(variance, 0.0))
    form = tuple(len(g) for g in grid)
    unvisited = ~_visited(residual.signals, names, grid)
    value, low, high = (
        np.where(unvisited, np.nan, x.reshape(form)) for x in (value, value - half, value + half)
    )
    units = tuple(signal_unit(name, residual.revolute) for name in names)
    return SmoothShape(joint, names, units, grid, value, low, high)


def _centred(names: Sequence[str]) -> bool:
    """Whether the mean of a function is subtracted: not of friction and of products."""
    return len(names) == 1 and not names[0].startswith("dq")


def _grid(name: str, ranges: SignalRanges, count: int) -> Array:
    kind, joint = split_name(name)
    low, high = ranges[SIGNAL_KEYS[kind]][:, joint]
    grid = np.linspace(low, high, count)
    if kind == "dq" and low < 0.0 < high:  # both sides of zero, where friction is discontinuous
        edge = 1e-6 * (high - low)
        grid = np.unique(np.concatenate([grid[np.abs(grid) > edge], [-edge, edge]]))
    return np.asarray(grid)


def _at(
    signals: SegmentSignals, names: Sequence[str], grid: Sequence[Array], ranges: SignalRanges
) -> Array:
    """Return basis functions (points, b) on the points of a grid; other signals are zero there."""
    points = np.stack([g.ravel() for g in np.meshgrid(*grid, indexing="ij")])
    shape = (points.shape[1], signals.segment.n)
    values = {key: np.zeros(shape) for key in signals.values}
    for name, at in zip(names, points, strict=True):
        kind, joint = split_name(name)
        values[SIGNAL_KEYS[kind]][:, joint] = at
    values["sign"] = np.sign(values["dq"])
    return _functions(replace(signals, values=values), tuple(names), ranges)


def _functions(signals: SegmentSignals, names: tuple[str, ...], ranges: SignalRanges) -> Array:
    """Return the basis functions (K, b) of one or two signals.

    Cosines have zero slope at the ends of an angle's range; a parabola is added, so that few of
    them suffice for a function with a slope there.
    """
    functions = product_basis(basis_functions(signals, ranges), names)
    if len(names) > 1 or split_name(names[0])[0] != "q":
        return functions
    low, high = ranges["q"][:, split_name(names[0])[1]]
    half = max(0.5 * float(high - low), 1e-9)
    x = np.clip((signal_values(signals, names[0]) - 0.5 * (low + high)) / half, -1.2, 1.2)
    return np.column_stack([functions, x, x**2])


def _visited(
    signals: Sequence[SegmentSignals], names: Sequence[str], grid: Sequence[Array]
) -> NDArray[np.bool_]:
    """Mark the points of a grid near which the recordings have samples."""
    visited = np.zeros([len(g) for g in grid], dtype=bool)
    if len(names) == 1:
        return ~visited
    cells = []
    for name, g in zip(names, grid, strict=True):
        along = np.concatenate([signal_values(s, name) for s in signals])
        cells.append(np.clip(np.searchsorted(0.5 * (g[1:] + g[:-1]), along), 0, len(g) - 1))
    rows, columns = cells
    for i in range(-NEIGHBOURS, NEIGHBOURS + 1):
        for j in range(-NEIGHBOURS, NEIGHBOURS + 1):
            at = (
                np.clip(rows + i, 0, visited.shape[0] - 1),
                np.clip(columns + j, 0, visited.shape[1] - 1),
            )
            visited[at] = True
    return visited


def _listed(values: Array) -> list[Any]:
    if values.ndim > 1:
        return [_listed(row) for row in values]
    return [float(v) if np.isfinite(v) else None for v in values]
