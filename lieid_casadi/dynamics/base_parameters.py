"""Base parameters: the combinations of parameters that torques depend on.

A change of parameters that leaves every torque unchanged expresses one column of the regressor by
the others. Columns are scanned in their order and kept if independent of those kept.

These changes follow from the geometry, without sampling motions. Parameters π are invisible iff
they leave the energy of every motion unchanged: kinetic energy zero, potential energy constant.
Going from the tip to the base, link i's change π_i can be compensated by its parent iff the energy
that it adds does not depend on joint i's coordinate or rate. Written in the functions 1, cos q,
sin q, cos 2q, sin 2q (or 1, q, q²), that is a small linear system per joint, whose solutions span
the whole null space. It is the recursive parameter null-space algorithm of Wensing, Niemeyer,
Slotine, "A geometric characterization of observability in inertial parameter identification", IJRR
2024, in energy form; gravity, zero gravity and special geometries need no separate treatment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.robot import Joint, Robot
from lieid_casadi.robot.inertia import (
    LINK_PARAMETER_NAMES,
    parameter_transport,
    relative,
    symmetric,
)

RANK_TOLERANCE = 1e-9  # relative; geometry written with 12 digits still counts as exact
ROUNDING = 1e-12


@dataclass(frozen=True)
class EnergyColumn:
    """A column whose torque derives from an energy of one joint, beside those of the links.

    ``kind`` is ``armature``, of the kinetic energy ½·q̇², or ``offset``, of the potential q (a
    constant torque). These two can coincide with link parameters, and the algorithm treats them
    together with the links. ``joint`` counts from 0.
    """

    kind: str
    joint: int


def null_space(robot: Robot, extra: Sequence[EnergyColumn | None] = ()) -> Array:
    """Return a basis (d, 10 n + e) of parameter changes that no motion reveals."""
    n, width = robot.n, 10 * robot.n + len(extra)
    chain = _Functionals(robot.gravity)
    blocks = []
    for i, joint in enumerate(robot.joints):
        before = robot.joints[i - 1].home if i else np.eye(4)
        geometry = _JointGeometry(joint, before)
        columns = [k for k, column in enumerate(extra) if column is not None and column.joint == i]
        kinds = [column.kind for k in columns if (column := extra[k]) is not None]
        solutions = _null(chain.conditions(geometry, kinds))
        block = np.zeros((len(solutions), width))
        block[:, 10 * i : 10 * i + 10] = solutions[:, :10]
        if i:
            block[:, 10 * i - 10 : 10 * i] = -solutions[:, :10] @ geometry.transport[0].T
        for position, k in enumerate(columns):
            block[:, 10 * n + k] = solutions[:, 10 + position]
        blocks.append(block)
        chain = chain.moved_by(geometry)
    return np.vstack(blocks)


class _JointGeometry:
    """One joint's matrices as coefficients of 1, cos q, sin q, cos 2q, sin 2q (or 1, q, q²)."""

    def __init__(self, joint: Joint, parent_home: Array) -> None:
        self.axis = joint.axis
        self.revolute = joint.revolute
        start = relative(parent_home, joint.home)
        nodes = 2 * np.pi * np.arange(5) / 5 if joint.revolute else np.array([-1.0, 0.0, 1.0])
        poses = [start @ _exponential(joint, float(q)) for q in nodes]
        basis = [np.ones_like(nodes), nodes, nodes**2]
        if joint.revolute:
            basis = [basis[0], *(f(k * nodes) for k in (1, 2) for f in (np.cos, np.sin))]
        inverse = np.linalg.inv(np.array(basis).T)
        self.transport, self.adjoint = (
            list(rounded(np.tensordot(inverse, [matrix(pose) for pose in poses], axes=1)))
            for matrix in (parameter_transport, _inverse_adjoint)
        )


class _Functionals:
    """The functionals of a link's parameters that its motions reveal.

    ``twists`` spans its velocities; ``kinetic`` (k, 10) spans the functionals that kinetic
    energy takes of link parameters; the potential energy's functional is
    ``potential`` + something in the span of ``varying``.
    """

    def __init__(self, gravity: Array) -> None:
        self.twists = np.zeros((0, 6))
        self.kinetic = np.zeros((0, 10))
        self.varying = np.zeros((0, 10))
        self.potential = np.concatenate([[0.0], -gravity, np.zeros(6)])[None]

    def conditions(self, joint: _JointGeometry, kinds: Sequence[str]) -> Array:
        """Return rows (r, 10 + len(kinds)) whose null space the parent can compensate."""
        own = _kinetic_row(joint.axis, joint.axis)
        mixed = [_kinetic_row(joint.axis, ad @ v) for ad in joint.adjoint for v in self.twists]
        revealed = np.vstack([self.kinetic, self.varying])
        rest = [revealed @ p for p in joint.transport[1:]]
        links = np.vstack([own, *mixed, *rest, *(self.potential @ p for p in joint.transport[1:])])
        further = np.zeros((len(links), len(kinds)))
        # a constant torque is the potential q: the linear function of a prismatic joint
        slope = len(links) - len(joint.transport) + 1
        for k, kind in enumerate(kinds):
            if kind == "armature":
                further[0, k] = 1.0
            elif kind == "offset" and not joint.revolute:
                further[slope, k] = 1.0
            elif kind == "offset":
                row = np.zeros((1, len(kinds)))
                row[0, k] = 1.0
                links, further = np.vstack([links, np.zeros(10)]), np.vstack([further, row])
        return np.hstack([links, further])

    def moved_by(self, joint: _JointGeometry) -> _Functionals:
        """Return the functionals that the motions of the next link reveal."""
        after = _Functionals(np.zeros(3))
        carried = [self.twists @ ad.T for ad in joint.adjoint]
        mixed = [_kinetic_row(joint.axis, v) for rows in carried for v in rows]
        own = _kinetic_row(joint.axis, joint.axis)
        after.twists = _span(np.vstack([*carried, joint.axis]))
        revealed = [self.kinetic @ p for p in joint.transport]
        after.kinetic = _span(np.vstack([*revealed, *mixed, own]))
        after.potential = self.potential @ joint.transport[0]
        varying = [self.varying @ p for p in joint.transport]
        turned = [self.potential @ p for p in joint.transport[1:]]
        after.varying = _span(np.vstack([*varying, *turned]))
        return after


def _exponential(joint: Joint, q: float) -> Array:
    """Return the matrix exp(ξ̂q) of a unit screw of zero pitch."""
    omega, v = joint.axis[:3], joint.axis[3:]
    pose = np.eye(4)
    if not joint.revolute:
        pose[:3, 3] = v * q
        return pose
    skew = _skew(omega)
    pose[:3, :3] = np.eye(3) + np.sin(q) * skew + (1 - np.cos(q)) * skew @ skew
    pose[:3, 3] = (np.eye(3) - pose[:3, :3]) @ np.cross(omega, v)
    return pose


def _inverse_adjoint(pose: Array) -> Array:
    back = pose[:3, :3].T
    return np.block([[back, np.zeros((3, 3))], [-back @ _skew(pose[:3, 3]), back]])


def _skew(w: Array) -> Array:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def _kinetic_row(u: Array, v: Array) -> Array:
    """Return the functional π ↦ uᵀ·E(π)·v as a row (1, 10)."""
    return np.asarray((_UNIT_INERTIAS @ v @ u)[None])


def _unit_inertia(unit: Array) -> Array:
    moment = _skew(unit[1:4])
    return np.block([[symmetric(unit[4:]), moment], [-moment, unit[0] * np.eye(3)]])


_UNIT_INERTIAS = np.array([_unit_inertia(unit) for unit in np.eye(10)])


def _span(rows: Array) -> Array:
    """Return an orthonormal basis of the rows' span."""
    if not len(rows):
        return rows
    _, sizes, basis = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(basis[sizes > RANK_TOLERANCE * max(sizes[0], 1.0)])


def _null(rows: Array) -> Array:
    _, sizes, basis = np.linalg.svd(rows)
    rank = int(np.sum(sizes > RANK_TOLERANCE * max(sizes[0], 1.0)))
    return np.asarray(basis[rank:])


def rounded(values: Array, tolerance: float = ROUNDING) -> Array:
    """Remove rounding errors around whole and half numbers."""
    halves = np.round(2 * values) / 2
    return np.where(np.abs(values - halves) < tolerance, halves, values)


Matrix = NDArray[Any]
SHOWN = 1e-9


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The minimal parameters β = combination · π of a regressor's columns."""

    names: tuple[str, ...]  # of all P columns
    kept: Indices  # (p,): columns that span the others: the first independent ones
    #: (p, P): coefficient 1 on the kept column, the rest on dropped ones. Floats, or floats and
    #: polynomials of lengths (`lieid_casadi.dynamics.symbolic_lengths`)
    combination: Matrix

    @property
    def count(self) -> int:
        """Number of base parameters p."""
        return len(self.kept)

    @cached_property
    def dropped(self) -> Indices:
        """Columns that are combinations of kept ones, or invisible."""
        return np.setdiff1d(np.arange(len(self.names)), self.kept)

    @cached_property
    def invisible(self) -> Indices:
        """Dropped columns that act on no torque at all."""
        visible = np.abs(self.combination[:, self.dropped]).max(axis=0, initial=0.0) > 0.0
        return np.asarray(self.dropped[~visible])

    def expression(self, k: int, *, digits: int = 6) -> str:
        """Return base parameter k as a sum of link parameters, equal factors grouped.

        E.g. ``mcx3 + 0.0825 (m4 + m5 + m6 + m7)``. Factors below 1e-9, from
        rounding in the robot's file, are not shown.
        """
        row = self.combination[k]
        first = int(self.kept[k])
        groups: dict[str, list[str]] = {}
        for index in np.flatnonzero(np.abs(row) > SHOWN):
            if index != first:
                sign, size = _factor(row[index], digits)
                groups.setdefault(f"{sign} {size}", []).append(self.names[index])
        terms = [self.names[first]]
        for factor, members in groups.items():
            sign, size = factor.split(maxsplit=1)
            if size == "1":
                terms += [f"{sign} {name}" for name in members]
            elif len(members) == 1:
                terms.append(f"{factor} {members[0]}")
            else:
                terms.append(f"{factor} ({' + '.join(members)})")
        return " ".join(terms)

    def lift(self, base: Matrix, prior: Matrix | None = None) -> Matrix:
        """Return parameters (P,) of base values (p,), the nearest to a prior (P,) or to zero."""
        start = np.zeros(len(self.names)) if prior is None else np.asarray(prior, dtype=float)
        miss = np.asarray(base) - self.combination @ start
        solution, *_ = np.linalg.lstsq(self.combination, miss, rcond=None)
        return np.asarray(start + solution)


def _factor(value: Any, digits: int) -> tuple[str, str]:
    """Return sign and size of a coefficient as text."""
    if isinstance(value, float):
        return "-" if value < 0 else "+", f"{abs(value):.{digits}g}"
    sign, size = value.text(digits=digits)
    return sign, size


def base_parameters(
    robot: Robot, extra: Sequence[EnergyColumn | None] = (), extra_names: Sequence[str] = ()
) -> BaseParameters:
    """Return the base parameters of [Y, further columns with names].

    ``extra`` has one entry per column after the 10 n link columns: its `EnergyColumn`, or None for
    a column that link parameters cannot reproduce.
    """
    names = [f"{name}{i + 1}" for i in range(robot.n) for name in LINK_PARAMETER_NAMES]
    return reduce(null_space(robot, extra), (*names, *extra_names))


def reduce(null: Matrix, names: tuple[str, ...]) -> BaseParameters:
    """Return the base parameters given a basis (d, P) of the invisible parameter changes."""
    columns = len(names)
    dropped = _last_touched(null)
    kept = np.setdiff1d(np.arange(columns), dropped)
    rows = np.linalg.solve(null[:, dropped], null[:, kept])
    combination = np.zeros((len(kept), columns))
    combination[np.arange(len(kept)), kept] = 1.0
    # null row: y_dropped + Σ row_k y_k = 0, so π_dropped adds −row_k to the kept k
    combination[:, dropped] = -rows.T
    return BaseParameters(names, kept, rounded(combination))


def _last_touched(null: Matrix) -> Indices:
    """Return the columns that are combinations of columns before them, last first.

    Elimination from the right: each invisible change is named after the last column it needs.
    """
    rows = null.copy()
    dropped: list[int] = []
    for column in reversed(range(rows.shape[1])):
        done = len(dropped)
        if done == len(rows):
            break
        pivot = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[pivot, column]) < RANK_TOLERANCE:
            rows[done:, column] = 0.0
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, column]
        rows[done + 1 :] -= np.outer(rows[done + 1 :, column], rows[done])
        dropped.append(column)
    return np.array(dropped, dtype=np.intp)
