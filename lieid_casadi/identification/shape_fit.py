"""Shape parameters by variable projection with bounds.

For given shapes the linear parameters follow by least squares, so that only the shapes are
searched: Golub & Pereyra, SIAM J. Numer. Anal. 1973, with Kaufman's Jacobian.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from lieid_casadi.identification.design import Design, Rows
from lieid_casadi.identification.shape_range import ShapeRange

Array = NDArray[np.float64]
STARTS = 7  # values tried over each shape's range before the descent
STEP = 1e-5  # of a shape's range, for the columns' derivative


@dataclass(frozen=True, eq=False)
class Projection:
    """The weighted regression at one set of shapes, its linear part solved."""

    matrix: Array
    orthonormal: Array
    values: Array
    residual: Array


def fit_shapes(
    design: Design, start: Array, links: Array | None, noise: Array, *, search: bool
) -> Array:
    """Return the shapes (s,) that minimize the weighted residual.

    Parameters
    ----------
    start : (s,)
    links : (10 n,) or None
        Link parameters that give the load.
    noise : (n,)
        Weights are 1/noise per joint.
    search : bool
        Whether to try values over the whole range first.
    """
    ranges = ShapeRange.of(design.model.shapes)
    if search:
        start = _best_start(design, start, links, noise)

    def residual(place: Array) -> Array:
        return _project(design.rows(ranges.shapes(place), links), noise).residual

    def jacobian(place: Array) -> Array:
        shapes = ranges.shapes(place)
        rows = design.rows(shapes, links)
        return _kaufman(design, rows, shapes, links, noise) * ranges.slope(shapes)

    inside = np.clip(ranges.place(start), 1e-6, 1.0 - 1e-6)
    result = least_squares(
        residual, inside, jac=jacobian, bounds=(0.0, 1.0), xtol=1e-6, ftol=1e-8, max_nfev=40
    )
    return ranges.shapes(np.asarray(result.x))


def shape_columns(design: Design, values: Array, shapes: Array, links: Array | None) -> list[Array]:
    """Return ∂torque/∂shape per joint (R, s) at given linear values (p,)."""
    rows = design.rows(shapes, links)
    steps = STEP * ShapeRange.of(design.model.shapes).slope(shapes)
    derivatives = [np.zeros((len(joint.torque), len(shapes))) for joint in rows.joints]
    for slot, members in _slots(design).items():
        step = np.zeros(len(shapes))
        step[members] = steps[members]
        moved = design.rows(shapes + step, links)
        for k in members:
            j = design.model.shapes[k].joint
            change = (moved.joints[j].matrix - rows.joints[j].matrix) / step[k]
            own = _columns_of(design, slot, j, rows.joints[j].columns)
            derivatives[j][:, k] = change[:, own] @ values[rows.joints[j].columns[own]]
    return derivatives


def _best_start(design: Design, start: Array, links: Array | None, noise: Array) -> Array:
    """Return for each shape the value of a coarse grid that fits its joint best."""
    best = start.copy()
    for slot in _slots(design).values():
        places = np.linspace(0.0, 1.0, STARTS + 2)[1:-1]
        ranges = ShapeRange.of([design.model.shapes[k] for k in slot])
        grids = np.array([ranges.shapes(np.full(len(slot), x)) for x in places]).T
        misfits = []
        for column in grids.T:
            trial = best.copy()
            trial[slot] = column
            rows = design.rows(trial, links)
            projection = _project(rows, noise)
            misfits.append(_joint_misfit(rows, projection.residual))
        per_joint = np.array(misfits)
        for position, k in enumerate(slot):
            joint = design.model.shapes[k].joint
            best[k] = grids[position][int(np.argmin(per_joint[:, joint]))]
    return best


def _joint_misfit(rows: Rows, residual: Array) -> Array:
    ends = np.cumsum([len(joint.torque) for joint in rows.joints])
    return np.array([np.sum(part**2) for part in np.split(residual, ends[:-1])])


def _slots(design: Design) -> dict[tuple[str, int], list[int]]:
    """Group shapes of one kind over joints: they touch different rows and move at once."""
    groups: dict[tuple[str, int], list[int]] = {}
    k = 0
    for p in design.model.placements:
        for position in range(len(p.effect.shapes)):
            groups.setdefault((p.effect.label, position), []).append(k)
            k += 1
    return groups


def _columns_of(
    design: Design, slot: tuple[str, int], joint: int, columns: NDArray[np.intp]
) -> NDArray[np.intp]:
    """Return which of a joint's active columns belong to an effect."""
    base = design.model.base_columns
    wanted = [
        position
        for position, column in enumerate(columns)
        if base[column].name.rpartition(".")[0] == slot[0] and base[column].joint == joint
    ]
    return np.array(wanted, dtype=np.intp)


def _stack(rows: Rows, noise: Array) -> tuple[Array, Array]:
    total = sum(len(joint.torque) for joint in rows.joints)
    matrix, torque = np.zeros((total, rows.count)), np.zeros(total)
    first = 0
    for joint, sigma in zip(rows.joints, noise, strict=True):
        last = first + len(joint.torque)
        matrix[first:last, joint.columns] = joint.matrix / sigma
        torque[first:last] = joint.torque / sigma
        first = last
    return matrix, torque


def _project(rows: Rows, noise: Array) -> Projection:
    matrix, torque = _stack(rows, noise)
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    orthonormal, triangle = np.linalg.qr(matrix / scale)
    reduced = orthonormal.T @ torque
    values = np.linalg.lstsq(triangle, reduced, rcond=1e-10)[0] / scale
    return Projection(matrix, orthonormal, values, torque - orthonormal @ reduced)


def _kaufman(design: Design, rows: Rows, shapes: Array, links: Array | None, noise: Array) -> Array:
    """Return ∂residual/∂shapes ≈ −(1 − QQᵀ)·(∂matrix/∂shape)·β."""
    projection = _project(rows, noise)
    per_joint = shape_columns(design, projection.values, shapes, links)
    slopes = np.vstack([d / sigma for d, sigma in zip(per_joint, noise, strict=True)])
    q = projection.orthonormal
    return np.asarray(-(slopes - q @ (q.T @ slopes)))
