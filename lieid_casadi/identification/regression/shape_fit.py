"""Shape parameters of a model's effects, fitted to a design by variable projection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import Rows
from lieid_casadi.identification.regression.variable_projection import (
    STEP,
    SeparableProblem,
    ShapeRange,
    minimize_shapes,
)
from lieid_casadi.recording import Processed

COMMAND_ERRORS = (80.0, 99.5)  # percentiles of |error| between which saturation is searched


def refine_shapes(design: Design, start: Array, links: Array | None, noise: Array) -> Array:
    """Return the shapes (s,) at a local minimum of the weighted residual.

    ``links`` (10 n,) give the load, None means no load; rows are weighted by the inverse of the
    ``noise`` (n,). Shapes that are not fitted stay as they are.
    """
    free = _fitted(design)
    problem = _weighted_problem(design, start, links, noise, free)
    return _replaced(start, free, minimize_shapes(problem, start[free]))


def shape_columns(design: Design, values: Array, shapes: Array, links: Array | None) -> list[Array]:
    """Return ∂torque/∂shapes per joint (R, s), N·m per unit of each shape."""
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


def _weighted_problem(
    design: Design, start: Array, links: Array | None, noise: Array, free: NDArray[np.intp]
) -> SeparableProblem:
    """Return the weighted regression as a separable problem in the shapes that are fitted."""
    rows = design.rows(start, links)

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
    return SeparableProblem(
        columns=columns,
        target=weighted([joint.torque for joint in rows.joints]),
        ranges=ShapeRange(whole.lower[free], whole.upper[free]),
        fixed=basis,
        slopes=slopes,
    )


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


def _same_shape_groups(design: Design) -> list[list[int]]:
    """Group the numbers of shapes that are one shape of one effect on several joints."""
    groups: dict[tuple[str, int], list[int]] = {}
    k = 0
    for p in design.model.placements:
        for position in range(len(p.effect.shapes)):
            groups.setdefault((p.effect.label, position), []).append(k)
            k += 1
    return list(groups.values())
