"""Shape parameters of a model's effects, fitted to a design by variable projection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.rows import Rows
from lieid_casadi.identification.regression.variable_projection import (
    STEP,
    SeparableProblem,
    ShapeRange,
    minimize_shapes,
)
from lieid_casadi.recording import Processed

GRID = 17  # values tried over each shape's range
COMMAND_ERRORS = (80.0, 99.5)  # percentiles of |error| between which saturation is searched
STARTS = 3  # best values of the grid from which a local search starts


def fit_shapes(
    design: Design, start: Array, links: Array | None, noise: Array, *, search: bool
) -> Array:
    """Return the shapes (s,) that minimize the weighted residual.

    Parameters
    ----------
    design : Design
    start : (s,)
        Shapes to start from if the range is not searched.
    links : (10 n,) or None
        Link parameters that give the load; None means no load.
    noise : (n,)
        Standard deviation of the residual per joint, N·m; rows are weighted by its inverse.
    search : bool
        Whether to try values over the whole range first; the cost can have several minima.
    """
    problem = _WeightedDesign.of(design, start, links, noise)
    starts = problem.starts() if search else [start]
    free = problem.free
    found = [minimize_shapes(problem.separable, each[free]) for each in starts]
    return problem.all_shapes(min(found, key=problem.separable.cost))


def shape_columns(design: Design, values: Array, shapes: Array, links: Array | None) -> list[Array]:
    """Return ∂torque/∂shapes per joint (R, s), N·m per unit of each shape.

    Parameters
    ----------
    design : Design
    values : (p,)
        Base values.
    shapes : (s,)
    links : (10 n,) or (10 n + m,) or None
        Parameters that give the load; None means no load.
    """
    coefficients = values[design.varying]
    here = design.varying_rows(shapes, links)
    steps = STEP * ShapeRange.of(design.model.shapes).slope(shapes)
    derivatives = [np.zeros((len(rows), len(shapes))) for rows in here]
    for members in _same_shape_groups(design):
        step = np.zeros(len(shapes))
        step[members] = steps[members]
        moved = design.varying_rows(shapes + step, links)
        for k in members:
            if not design.model.shapes[k].fitted:
                continue
            j = design.model.shapes[k].joint
            own = design.columns_of_shape(k)
            change = (moved[j] - here[j])[:, own] / step[k]
            derivatives[j][:, k] = change @ coefficients[own]
    return derivatives


@dataclass(frozen=True, eq=False)
class _WeightedDesign:
    """The weighted regression of a design as a separable problem.

    Its unknowns are the shapes that are fitted. ``ends`` are the row numbers at which one joint's
    rows end and the next one's begin.
    """

    design: Design
    separable: SeparableProblem
    ends: NDArray[np.intp]
    start: Array

    @property
    def free(self) -> NDArray[np.intp]:
        """Numbers of the shapes that are fitted."""
        return _fitted(self.design)

    def all_shapes(self, fitted: Array) -> Array:
        """Return all shapes (s,), from those that are fitted."""
        return _replaced(self.start, self.free, fitted)

    @classmethod
    def of(cls, design: Design, start: Array, links: Array | None, noise: Array) -> _WeightedDesign:
        """Return the problem of `fit_shapes`, with the same parameters."""
        rows, free = design.rows(start, links), _fitted(design)

        def weighted(per_joint: Sequence[Array]) -> Array:
            return np.concatenate([x / s for x, s in zip(per_joint, noise, strict=True)])

        def columns(shapes: Array) -> Array:
            return weighted(design.varying_rows(_replaced(start, free, shapes), links))

        def slopes(shapes: Array, coefficients: Array) -> Array:
            values = np.zeros(design.model.base.count)
            values[design.varying] = coefficients
            every = _replaced(start, free, shapes)
            return weighted(shape_columns(design, values, every, links))[:, free]

        fixed = weighted(_fixed_columns(design, rows))
        scale = np.linalg.norm(fixed, axis=0)
        basis, _ = np.linalg.qr(fixed / np.where(scale > 0.0, scale, 1.0))
        whole = resolved_range(design)
        separable = SeparableProblem(
            columns=columns,
            target=weighted([joint.torque for joint in rows.joints]),
            ranges=ShapeRange(whole.lower[free], whole.upper[free]),
            fixed=basis,
            slopes=slopes,
        )
        return cls(design, separable, np.cumsum(rows.lengths, dtype=np.intp)[:-1], start)

    def starts(self) -> list[Array]:
        """Return starts from a grid over the ranges: the best values of each joint, then the next.

        Shapes of one kind on several joints act on different rows and are tried together.
        """
        ranges, free = resolved_range(self.design), self.free
        first = _replaced(self.start, free, self.design.model.initial_shapes[free])
        starts = np.tile(first, (STARTS, 1))
        places = (np.arange(GRID) + 0.5) / GRID
        for members in _same_shape_groups(self.design):
            if members[0] not in free:
                continue
            grid = []
            for place in places:
                trial = starts[0].copy()
                trial[members] = ranges.shapes(np.full(len(trial), place))[members]
                grid.append(self._joint_costs(trial))
            for k in members:
                costs = np.array(grid)[:, self.design.model.shapes[k].joint]
                for rank, index in enumerate(_local_minima(costs)[:STARTS]):
                    starts[rank:, k] = ranges.shapes(np.full(starts.shape[1], places[index]))[k]
        return list(np.unique(starts, axis=0))

    def _joint_costs(self, shapes: Array) -> Array:
        """Return the sum of squared weighted residuals of each joint (n,)."""
        parts = np.split(self.separable.solve(shapes[self.free]).residual, self.ends)
        return np.array([np.sum(part**2) for part in parts])


def command_error_range(segments: Sequence[Processed], joint: int) -> tuple[float, float]:
    """Return the errors of position control between which a joint in motion shows saturation, rad.

    Of the largest fifth: where torque saturates at smaller errors than most of the recorded ones,
    the column of the effect is the recorded torque itself, but for a constant, and every model
    fits.
    """
    sizes = []
    for s in segments:
        if s.command_error is not None:
            moving = np.abs(s.dq[:, joint]) > s.dead_zone[joint]
            sizes.append(np.abs(s.command_error[moving, joint]))
    every = np.concatenate(sizes) if sizes else np.zeros(0)
    low, high = np.percentile(every, COMMAND_ERRORS) if len(every) else (0.0, 0.0)
    return float(low), float(high)


def resolved_range(design: Design) -> ShapeRange:
    """Return the bounds of the shapes, those of errors of position control within the recorded."""
    whole = ShapeRange.of(design.model.shapes)
    lower, upper = whole.lower.copy(), whole.upper.copy()
    shapes = [(p.joint, shape) for p in design.model.placements for shape in p.effect.shapes]
    for k, (joint, shape) in enumerate(shapes):
        if shape.resolved_by == "command_error":
            low, high = np.clip(command_error_range(design.segments, joint), lower[k], upper[k])
            if low < high:
                lower[k], upper[k] = low, high
    return ShapeRange(lower, upper)


def _fitted(design: Design) -> NDArray[np.intp]:
    return np.flatnonzero([shape.fitted for shape in design.model.shapes])


def _replaced(values: Array, at: NDArray[np.intp], new: Array) -> Array:
    """Return values with new ones at some positions."""
    replaced = values.copy()
    replaced[at] = new
    return replaced


def _fixed_columns(design: Design, rows: Rows) -> list[Array]:
    """Return the base columns that depend neither on shapes nor on the load, per joint (R, f)."""
    fixed = np.ones(rows.count, dtype=bool)
    fixed[design.varying] = False
    found = []
    for joint in rows.joints:
        matrix = np.zeros((len(joint.torque), rows.count))
        matrix[:, joint.columns] = joint.matrix
        found.append(matrix[:, fixed])
    return found


def _local_minima(costs: Array) -> list[int]:
    """Return the indices of local minima, lowest first."""
    padded = np.concatenate([[np.inf], costs, [np.inf]])
    lower = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])
    return sorted(np.flatnonzero(lower).tolist(), key=lambda k: float(costs[k]))


def _same_shape_groups(design: Design) -> list[list[int]]:
    """Group the numbers of shapes that are one shape of one effect on several joints."""
    groups: dict[tuple[str, int], list[int]] = {}
    k = 0
    for p in design.model.placements:
        for position in range(len(p.effect.shapes)):
            groups.setdefault((p.effect.label, position), []).append(k)
            k += 1
    return list(groups.values())
