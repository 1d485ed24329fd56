"""Base parameters from geometry, without sampling motions.

Parameters π are invisible iff they leave the energy of every motion unchanged: kinetic energy
zero, potential energy constant. Going from the tip to the base, link i's change π_i can be
compensated by its parent iff the energy that it adds does not depend on joint i's coordinate
or rate. Written in the functions 1, cos q, sin q, cos 2q, sin 2q (or 1, q, q²), that is a
small linear system per joint, whose solutions span the whole null space. It is the recursive
parameter null-space algorithm of Wensing, Niemeyer, Slotine, "A geometric characterization of
observability in inertial parameter identification", IJRR 2024, in energy form; gravity, zero
gravity and special geometries need no case of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.robot import Joint, Robot
from lieid_casadi.robot.inertia import LINK_PARAMETER_NAMES, pseudo_inertia

Matrix = NDArray[np.float64]
RANK_TOLERANCE = 1e-9  # relative; geometry written with 12 digits still counts as exact
ROUNDING = 1e-12
SHOWN = 1e-9


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The minimal parameters β = combination · π of a regressor's columns.

    Attributes
    ----------
    names : tuple of str
        Names of all P columns.
    kept : (p,) int
        Columns that span the others; scanned first to last, kept if independent.
    combination : (p, P)
        β = combination @ π: coefficient 1 on the kept column, the rest on dropped ones.
    """

    names: tuple[str, ...]
    kept: NDArray[np.intp]
    combination: Matrix

    @property
    def count(self) -> int:
        """Number of base parameters p."""
        return len(self.kept)

    @cached_property
    def dropped(self) -> NDArray[np.intp]:
        """Columns that are combinations of kept ones, or invisible."""
        return np.setdiff1d(np.arange(len(self.names)), self.kept)

    @cached_property
    def invisible(self) -> NDArray[np.intp]:
        """Dropped columns that act on no torque at all."""
        visible = np.abs(self.combination[:, self.dropped]).max(axis=0, initial=0.0) > 0.0
        return np.asarray(self.dropped[~visible])

    def expression(self, k: int, *, digits: int = 6) -> str:
        """Return base parameter k as a sum of link parameters, equal factors grouped.

        E.g. ``mcx3 + 0.0825 (m4 + m5 + m6 + m7)``. Factors that come from the rounding of a
        robot's file are not shown.
        """
        row = self.combination[k]
        first = int(self.kept[k])
        groups: dict[str, list[str]] = {}
        for index in np.flatnonzero(np.abs(row) > SHOWN):
            if index != first:
                sign = "-" if row[index] < 0 else "+"
                size = f"{abs(row[index]):.{digits}g}"
                groups.setdefault(f"{sign} {size}", []).append(self.names[index])
        terms = [self.names[first]]
        for factor, members in groups.items():
            sign, size = factor.split()
            if size == "1":
                terms += [f"{sign} {name}" for name in members]
            elif len(members) == 1:
                terms.append(f"{factor} {members[0]}")
            else:
                terms.append(f"{factor} ({' + '.join(members)})")
        return " ".join(terms)

    def lift(self, base: Matrix, prior: Matrix | None = None) -> Matrix:
        """Return parameters (P,) with the given base values (p,), nearest to a prior (P,)."""
        start = np.zeros(len(self.names)) if prior is None else np.asarray(prior, dtype=float)
        miss = np.asarray(base) - self.combination @ start
        solution, *_ = np.linalg.lstsq(self.combination, miss, rcond=None)
        return np.asarray(start + solution)


@dataclass(frozen=True)
class EnergyColumn:
    """A column beside the links whose torque comes from an energy of one joint.

    ``armature`` stands for ½·q̇², ``offset`` for the potential q (a constant torque): those
    two can coincide with link parameters, and the algorithm treats them with the links.
    """

    kind: str
    joint: int


def link_parameter_names(n: int) -> tuple[str, ...]:
    """Return the names of 10 n link parameters, joints from 1: ``m1 … Izz1, m2 …``."""
    return tuple(f"{name}{i}" for i in range(1, n + 1) for name in LINK_PARAMETER_NAMES)


def base_parameters(
    robot: Robot,
    extra: Sequence[EnergyColumn | None] = (),
    extra_names: Sequence[str] = (),
) -> BaseParameters:
    """Return the base parameters of [Y, further columns].

    Parameters
    ----------
    extra : sequence
        One entry per column after the 10 n link columns: its `EnergyColumn`, or None for a
        column that no link can imitate.
    extra_names : sequence of str
        Their names.
    """
    null = null_space(robot, extra)
    names = (*link_parameter_names(robot.n), *extra_names)
    return reduce(null, names)


def reduce(null: Matrix, names: tuple[str, ...]) -> BaseParameters:
    """Return the base parameters given a basis (d, P) of the invisible parameter changes."""
    dropped = _last_touched(null)
    kept = np.setdiff1d(np.arange(len(names)), dropped)
    rows = np.linalg.solve(null[:, dropped], null[:, kept])
    combination = np.zeros((len(kept), len(names)))
    combination[np.arange(len(kept)), kept] = 1.0
    # null row: y_dropped + Σ row_k y_k = 0, so π_dropped adds −row_k to the kept k
    combination[:, dropped] = -rows.T
    return BaseParameters(names, kept, _rounded(combination))


def null_space(robot: Robot, extra: Sequence[EnergyColumn | None] = ()) -> Matrix:
    """Return a basis (d, 10 n + len(extra)) of parameter changes that no motion shows."""
    n, width = robot.n, 10 * robot.n + len(extra)
    chain = _Reach(robot.gravity)
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

    def __init__(self, joint: Joint, parent_home: Matrix) -> None:
        self.axis = joint.axis
        self.revolute = joint.revolute
        start = np.linalg.solve(parent_home, joint.home)

        def here(q: float) -> Matrix:
            return start @ _exponential(joint.axis, q)

        self.transport = _coefficients(lambda q: parameter_transport(here(q)), joint.revolute)
        self.adjoint = _coefficients(lambda q: _inverse_adjoint(here(q)), joint.revolute)


class _Reach:
    """What the motions of a link can show of its parameters.

    ``twists`` spans its velocities; ``kinetic`` (k, 10) spans the functionals that kinetic
    energy takes of link parameters; the potential energy's functional is
    ``potential`` + something in the span of ``varying``.
    """

    def __init__(self, gravity: Matrix) -> None:
        self.twists = np.zeros((0, 6))
        self.kinetic = np.zeros((0, 10))
        self.varying = np.zeros((0, 10))
        self.potential = np.concatenate([[0.0], -gravity, np.zeros(6)])[None]

    def conditions(self, joint: _JointGeometry, kinds: Sequence[str]) -> Matrix:
        """Rows whose null space is what the parent can compensate: (rows, 10 + len(kinds))."""
        own = _kinetic_row(joint.axis, joint.axis)
        mixed = [_kinetic_row(joint.axis, ad @ v) for ad in joint.adjoint for v in self.twists]
        seen = np.vstack([self.kinetic, self.varying])
        rest = [seen @ p for p in joint.transport[1:]]
        links = np.vstack([own, *mixed, *rest, *(self.potential @ p for p in joint.transport[1:])])
        further = np.zeros((len(links), len(kinds)))
        # a constant torque is the potential q: the linear function of a sliding joint
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

    def moved_by(self, joint: _JointGeometry) -> _Reach:
        """Return what the next link's motions show."""
        after = _Reach(np.zeros(3))
        carried = [self.twists @ ad.T for ad in joint.adjoint]
        mixed = [_kinetic_row(joint.axis, v) for rows in carried for v in rows]
        own = _kinetic_row(joint.axis, joint.axis)
        after.twists = _span(np.vstack([*carried, joint.axis]))
        seen = [self.kinetic @ p for p in joint.transport]
        after.kinetic = _span(np.vstack([*seen, *mixed, own]))
        after.potential = self.potential @ joint.transport[0]
        varying = [self.varying @ p for p in joint.transport]
        turned = [self.potential @ p for p in joint.transport[1:]]
        after.varying = _span(np.vstack([*varying, *turned]))
        return after


def parameter_transport(pose: Matrix) -> Matrix:
    """Return P (10, 10): a body's link parameters seen from the parent frame, given its pose."""
    moved = pose @ _UNIT_PSEUDO_INERTIAS @ pose.T
    return np.asarray(np.tensordot(_FROM_PSEUDO_INERTIA, moved, axes=((1, 2), (1, 2))))


def _from_pseudo_inertia() -> Matrix:
    """Return the tensor (10, 4, 4) that takes link parameters out of a pseudo-inertia."""
    tensor = np.zeros((10, 4, 4))
    tensor[0, 3, 3] = 1.0
    tensor[[1, 2, 3], [0, 1, 2], 3] = 1.0
    for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), start=4):
        tensor[k, i, j] -= 1.0  # the inertia is trace(Σ)·1 − Σ
        if i == j:
            tensor[k, [0, 1, 2], [0, 1, 2]] += 1.0
    return tensor


_UNIT_PSEUDO_INERTIAS = np.array([pseudo_inertia(unit) for unit in np.eye(10)])
_FROM_PSEUDO_INERTIA = _from_pseudo_inertia()


def _coefficients(function: Callable[[float], Matrix], revolute: bool) -> list[Matrix]:
    """Return the exact coefficients of a trigonometric (or plain) polynomial of degree 2."""
    nodes = 2 * np.pi * np.arange(5) / 5 if revolute else np.array([-1.0, 0.0, 1.0])
    one = np.ones_like(nodes)
    basis = (
        [one, np.cos(nodes), np.sin(nodes), np.cos(2 * nodes), np.sin(2 * nodes)]
        if revolute
        else [one, nodes, nodes**2]
    )
    values = np.array([function(float(q)) for q in nodes])
    inverse = np.linalg.inv(np.array(basis).T)
    return list(_rounded(np.tensordot(inverse, values, axes=1)))


def _exponential(axis: Matrix, q: float) -> Matrix:
    """Return the matrix exp(ξ̂q) of a unit screw of zero pitch."""
    omega, v = axis[:3], axis[3:]
    pose = np.eye(4)
    if np.linalg.norm(omega) < 0.5:
        pose[:3, 3] = v * q
        return pose
    skew = _skew(omega)
    pose[:3, :3] = np.eye(3) + np.sin(q) * skew + (1 - np.cos(q)) * skew @ skew
    pose[:3, 3] = (np.eye(3) - pose[:3, :3]) @ np.cross(omega, v)
    return pose


def _inverse_adjoint(pose: Matrix) -> Matrix:
    back = pose[:3, :3].T
    return np.block([[back, np.zeros((3, 3))], [-back @ _skew(pose[:3, 3]), back]])


def _skew(w: Matrix) -> Matrix:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def _kinetic_row(u: Matrix, v: Matrix) -> Matrix:
    """Return the functional π ↦ uᵀ·E(π)·v as a row (1, 10)."""
    return np.asarray((_UNIT_INERTIAS @ v @ u)[None])


def _unit_inertia(unit: Matrix) -> Matrix:
    moment = _skew(unit[1:4])
    xx, xy, yy, xz, yz, zz = unit[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return np.block([[inertia, moment], [-moment, unit[0] * np.eye(3)]])


_UNIT_INERTIAS = np.array([_unit_inertia(unit) for unit in np.eye(10)])


def _span(rows: Matrix) -> Matrix:
    """Return an orthonormal basis of the rows' span."""
    if not len(rows):
        return rows
    _, sizes, basis = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(basis[sizes > RANK_TOLERANCE * max(sizes[0], 1.0)])


def _null(rows: Matrix) -> Matrix:
    _, sizes, basis = np.linalg.svd(rows)
    rank = int(np.sum(sizes > RANK_TOLERANCE * max(sizes[0], 1.0)))
    return np.asarray(basis[rank:])


def _last_touched(null: Matrix) -> NDArray[np.intp]:
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


def _rounded(values: Matrix) -> Matrix:
    """Remove rounding errors around whole and half numbers."""
    halves = np.round(2 * values) / 2
    return np.where(np.abs(values - halves) < ROUNDING, halves, values)
