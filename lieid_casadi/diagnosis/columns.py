"""Columns of candidates on the rows of the joints, in groups: a candidate at one grid point."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.diagnosis.candidates import Candidate, Course, is_delay
from lieid_casadi.effects import ArmEffect, Effect
from lieid_casadi.expressions.effect_function import OWN, EffectFunction
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.segment_columns import (
    ModelAlongSegment,
    filtered_columns,
    model_along,
    signals_along,
)
from lieid_casadi.identification.uncertainty.noise_model import Runs
from lieid_casadi.recording import Processed

#: Columns (N_j, c) by joint, of one candidate at one grid point.
PointColumns = Mapping[int, Array]
#: Values of a shape parameter that a scan evaluates at once: bounds the memory.
CHUNK = 128
PHASE_STEP = 0.35  # of a scan, in turns over the range of motion: half a turn would miss peaks
SLOW_PERCENTILE = 25.0  # of the speeds at which the highest harmonic must pass the low-pass filter
SCAN_PEAKS = 8  # that become grid points


@dataclass(frozen=True, eq=False)
class SegmentSignals:
    """The signals that effects depend on, along one segment."""

    segment: Processed
    #: by signal: (K, n) at its instants
    values: dict[str, Array]
    #: for effects that are computed along the whole segment
    arm: ModelAlongSegment

    @classmethod
    def of(cls, fit: Fit, segment: Processed) -> SegmentSignals:
        """Return the signals of a segment; the load is that of the fit."""
        arm = model_along(fit.compiled, segment, fit.shapes, fit.parameters)
        return cls(segment, signals_along(segment, arm.load, arm.late_error), arm)


@dataclass(frozen=True, eq=False)
class JointColumns:
    """The columns, by their indices (m,), that act on one joint, on its rows (R_j, m)."""

    columns: Indices
    matrix: Array


@dataclass(frozen=True, eq=False)
class RowPart:
    """One recording or each of them, whole or with a change in its course."""

    recording: int | None
    course: Course | None
    #: by joint, (R_j, G, f): what columns are multiplied by at each of G points of the course
    factors: Sequence[Array]


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of candidates, in groups: one group is a candidate at one point of its grid."""

    owners: tuple[Candidate, ...]
    #: (G,) each: of a group its candidate, its grid point, its first column, its number of columns
    owner: Indices
    point: Indices
    start: Indices
    size: Indices
    joints: tuple[JointColumns, ...]

    @cached_property
    def count(self) -> int:
        """Number of columns of all groups."""
        return int(self.size.sum())

    def candidate(self, group: int) -> Candidate:
        """Return the candidate of a group."""
        return self.owners[int(self.owner[group])]

    def shapes(self, group: int) -> Array:
        """Return the grid point of a group."""
        return np.asarray(self.candidate(group).grid[int(self.point[group])])

    def of_group(self, group: int) -> Indices:
        """Return the indices of a group's columns."""
        first = int(self.start[group])
        return np.arange(first, first + int(self.size[group]))

    @cached_property
    def reach(self) -> Mask:
        """Whether each group acts on each joint (n, G)."""
        n = len(self.joints)
        acts = [[c.reaches_all or c.joint == j for c in self.owners] for j in range(n)]
        return np.array(acts, dtype=bool)[:, self.owner]

    @cached_property
    def parameters(self) -> Array:
        """Number of parameters that each group adds to a model (G,)."""
        return np.array([c.parameters for c in self.owners], dtype=float)[self.owner]

    @cached_property
    def delays(self) -> Mask:
        """Mark the groups (G,) of delays and filters of torques."""
        return np.array([is_delay(c) for c in self.owners], dtype=bool)[self.owner]

    @cached_property
    def cells(self) -> tuple[Array, Array]:
        """Least and largest coefficient of each column (m,), see `Candidate.cell`."""
        cells = [self.candidate(g).cell(int(k)) for g, k in enumerate(self.point)]
        low, high = np.repeat(np.reshape(cells, (-1, 2)), self.size, axis=0).T
        return low, high

    @cached_property
    def places(self) -> list[Indices]:
        """Place of each column (m,) among those of each joint, −1 where it is not among them."""
        found = [np.full(self.count, -1, dtype=np.intp) for _ in self.joints]
        for place, own in zip(found, self.joints, strict=True):
            place[own.columns] = np.arange(len(own.columns))
        return found

    @cached_property
    def by_size(self) -> tuple[tuple[Indices, Indices], ...]:
        """The groups of each size, and their columns (g, k)."""
        found = []
        for size in np.unique(self.size):
            groups = np.flatnonzero(self.size == size)
            found.append((groups, self.start[groups][:, None] + np.arange(size)))
        return tuple(found)

    @cached_property
    def pairs(self) -> tuple[Indices, Indices]:
        """The first and the second column of each product within a group, see `within`."""
        first = [np.repeat(own, own.shape[1], axis=1).ravel() for _, own in self.by_size]
        second = [np.tile(own, own.shape[1]).ravel() for _, own in self.by_size]
        none = np.zeros(0, dtype=np.intp)
        return np.concatenate([none, *first]), np.concatenate([none, *second])

    @cached_property
    def diagonal(self) -> Indices:
        """The place in `pairs` of each column's product with itself (m,)."""
        first, second = self.pairs
        at = np.flatnonzero(first == second)
        return np.asarray(at[np.argsort(first[at])])

    def within(self, products: Array) -> list[Array]:
        """Return products of `pairs` as (g, k, k) of the groups of each size, which are views."""
        found, first = [], 0
        for _, own in self.by_size:
            shape = (*own.shape, own.shape[1])
            found.append(products[first : first + own.size * own.shape[1]].reshape(shape))
            first += own.size * own.shape[1]
        return found

    def dense(self, group: int) -> list[Array]:
        """Return a group's columns on the rows of each joint: (R_j, k) each."""
        wanted, found = self.of_group(group), []
        for own, place in zip(self.joints, self.places, strict=True):
            dense, at = np.zeros((len(own.matrix), len(wanted))), place[wanted]
            dense[:, at >= 0] = own.matrix[:, at[at >= 0]]
            found.append(dense)
        return found

    def stacked(self, group: int) -> Array:
        """Return a group's columns on the rows of all joints (R, k)."""
        return np.concatenate(self.dense(group))

    def weighted(self, weights: Sequence[Array]) -> Columns:
        """Return the columns with the rows of each joint multiplied by weights (R_j,)."""
        joints = tuple(
            JointColumns(own.columns, own.matrix * w[:, None])
            for own, w in zip(self.joints, weights, strict=True)
        )
        return replace(self, joints=joints)

    def of_groups(self, groups: Indices) -> Columns:
        """Return the columns of some groups (in ascending order) alone."""
        place = np.full(self.count, -1, dtype=np.intp)
        kept = np.concatenate([np.zeros(0, dtype=np.intp), *map(self.of_group, groups)])
        place[kept] = np.arange(len(kept))
        joints = tuple(
            JointColumns(place[own.columns[here]], own.matrix[:, here])
            for own in self.joints
            for here in [place[own.columns] >= 0]
        )
        size = self.size[groups]
        start = np.cumsum(size) - size
        return Columns(self.owners, self.owner[groups], self.point[groups], start, size, joints)

    def only_in(self, parts: Sequence[RowPart]) -> Columns:
        """Return copies of all groups that act in parts of the rows only."""
        owners, owner, point, size = list[Candidate](), list[int](), list[int](), list[int]()
        pieces: list[list[tuple[int, Array]]] = [[] for _ in self.joints]
        first = 0
        for g, part in product(range(len(self.size)), parts):
            dense, copy = self.dense(g), replace(self.candidate(g), recording=part.recording)
            points = [int(self.point[g])]
            if part.course is not None:
                points = list(range(len(part.course.at)))
                copy = replace(copy, course=part.course, grid=np.zeros((len(points), 0)))
            owners.append(copy)
            for k, place in enumerate(points):
                owner.append(len(owners) - 1)
                point.append(place)
                for j, (values, factors) in enumerate(zip(dense, part.factors, strict=True)):
                    if values.any():
                        own = np.hstack([values * f[:, None] for f in factors[:, k].T])
                        pieces[j].append((first, own))
                size.append(int(self.size[g]) * part.factors[0].shape[2])
                first += size[-1]
        counts = [len(own.matrix) for own in self.joints]
        return assemble(owners, owner, point, size, pieces, counts)

    def joined(self, further: Sequence[Columns]) -> Columns:
        """Return the columns and further ones, of other owners."""
        every = (self, *further)
        counts = [len(each.owners) for each in every]
        firsts = np.cumsum([0, *(each.count for each in every)])
        joints = tuple(
            JointColumns(
                np.concatenate([f + own.columns for f, own in zip(firsts, of_joint, strict=False)]),
                np.hstack([own.matrix for own in of_joint]),
            )
            for of_joint in zip(*(each.joints for each in every), strict=True)
        )
        return Columns(
            tuple(owner for each in every for owner in each.owners),
            np.concatenate([sum(counts[:k]) + each.owner for k, each in enumerate(every)]),
            np.concatenate([each.point for each in every]),
            np.concatenate([f + each.start for f, each in zip(firsts, every, strict=False)]),
            np.concatenate([each.size for each in every]),
            joints,
        )


def assemble(
    owners: Sequence[Candidate],
    owner: Sequence[int],
    point: Sequence[int],
    size: Sequence[int],
    pieces: Sequence[Sequence[tuple[int, Array]]],
    rows: Sequence[int],
) -> Columns:
    """Assemble columns from pieces of each joint: first column, and columns (R_j, k)."""
    sizes = np.array(size, dtype=np.intp)
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)[:-1]
    joints = []
    for own, count in zip(pieces, rows, strict=True):
        at = [np.arange(first, first + m.shape[1]) for first, m in own]
        joints.append(
            JointColumns(
                np.concatenate([np.zeros(0, dtype=np.intp), *at]),
                np.concatenate([np.zeros((count, 0)), *(m for _, m in own)], axis=1),
            )
        )
    of_groups = np.array(owner, dtype=np.intp), np.array(point, dtype=np.intp)
    return Columns(tuple(owners), *of_groups, start, sizes, tuple(joints))


@dataclass(frozen=True, eq=False)
class ColumnStore:
    """Columns that were evaluated, by label and grid point, so that none is evaluated twice.

    ``lasting`` depend on the measured signals alone and are shared by all fits on the same rows;
    ``of_fit`` depend on the fit.
    """

    lasting: dict[str, PointColumns] = field(default_factory=dict)
    of_fit: dict[str, PointColumns] = field(default_factory=dict)
    scans: dict[tuple[str, int], tuple[Array, float]] = field(default_factory=dict)
    functions: dict[str, EffectFunction] = field(default_factory=dict)

    def function(self, effect: Effect) -> EffectFunction:
        """Return an effect as a function of signals."""
        if effect.label not in self.functions:
            self.functions[effect.label] = EffectFunction(effect)
        return self.functions[effect.label]

    def of(self, effect: Effect) -> dict[str, PointColumns]:
        """Return the part in which an effect's columns are kept."""
        depends = isinstance(effect, ArmEffect) or "load" in effect.signals
        return self.of_fit if depends else self.lasting


def evaluate(
    wanted: Sequence[Candidate],
    signals: Sequence[SegmentSignals],
    runs: Sequence[Runs],
    store: ColumnStore,
) -> Columns:
    """Evaluate and filter the columns of all candidates on the runs of each joint.

    Grid points that are in ``store`` are not evaluated again; the others are added to it.
    """
    _evaluate_missing(wanted, signals, runs, store)
    owner, point, size, first = list[int](), list[int](), list[int](), 0
    pieces: list[list[tuple[int, Array]]] = [[] for _ in runs]
    for k, candidate in enumerate(wanted):
        found = store.of(candidate.effect)
        for number, row in enumerate(candidate.grid):
            for joint, matrix in found[_key(candidate, row)].items():
                pieces[joint].append((first, matrix))
            owner.append(k)
            point.append(number)
            size.append(len(candidate.effect.coefficients))
            first += size[-1]
    return assemble(wanted, owner, point, size, pieces, [r.count for r in runs])


def _key(candidate: Candidate, row: Array) -> str:
    """Return what the columns at a grid point depend on."""
    effect = candidate.effect
    same = isinstance(effect, ArmEffect) and effect.linear
    return f"{candidate.placement.label} {'' if same else row.tobytes().hex()}"


def _evaluate_missing(
    wanted: Sequence[Candidate],
    signals: Sequence[SegmentSignals],
    runs: Sequence[Runs],
    store: ColumnStore,
) -> None:
    """Evaluate the grid points that are not in the store, those of one effect together."""
    together: dict[str, list[Candidate]] = {}
    for candidate in wanted:
        found = store.of(candidate.effect)
        missing = [row for row in candidate.grid if _key(candidate, row) not in found]
        if missing:
            new = replace(candidate, grid=np.array(missing))
            together.setdefault(f"{new.effect.label} {new.grid.tobytes().hex()}", []).append(new)
    for group in together.values():
        effect, grid = group[0].effect, group[0].grid
        if isinstance(effect, ArmEffect):
            columns = _of_arm_effect(group, signals, runs)
        else:
            columns = _of_joint_effect(store.function(effect), group, signals, runs)
        width = len(effect.coefficients)
        for candidate, own in zip(group, columns, strict=True):
            for k, row in enumerate(grid):
                store.of(effect)[_key(candidate, row)] = {
                    j: matrix[:, k * width : (k + 1) * width] for j, matrix in own.items()
                }


def _of_joint_effect(
    function: EffectFunction,
    group: Sequence[Candidate],
    signals: Sequence[SegmentSignals],
    runs: Sequence[Runs],
) -> list[PointColumns]:
    """Return the columns (N_j, G·c) of the candidates of one effect by joint."""
    places, grid = [c.placement for c in group], group[0].grid
    parts = [filtered_columns(function, s.segment, s.values, places, grid) for s in signals]
    values = np.concatenate(parts)
    return [
        {c.joint: values[runs[c.joint].all, k].reshape(runs[c.joint].count, -1)}
        for k, c in enumerate(group)
    ]


def _of_arm_effect(
    group: Sequence[Candidate], signals: Sequence[SegmentSignals], runs: Sequence[Runs]
) -> list[PointColumns]:
    """Return the columns of effects that are computed along a whole segment."""
    found: list[PointColumns] = []
    for c in group:
        assert isinstance(c.effect, ArmEffect)
        grid = c.grid
        if c.effect.shapes:
            grid = np.hstack([np.zeros((len(grid), len(c.effect.coefficients))), grid])
        own = [c.joint] if c.effect.reach == "joint" else list(range(len(runs)))
        parts = []
        for s in signals:
            raw = [c.effect.segment_columns(s.arm, c.joint, x)[:, own] for x in grid]
            parts.append(s.segment.filter(np.concatenate(raw, axis=2)))
        values = np.concatenate(parts)
        found.append({j: values[runs[j].all, k] for k, j in enumerate(own)})
    return found


def scan_peaks(
    effect: Effect,
    joint: int,
    signals: Sequence[SegmentSignals],
    runs: Runs,
    residual: Array,
    store: ColumnStore,
) -> tuple[Array, float]:
    """Return the values (P, 1) of a scanned shape parameter with the largest gains, and neighbours.

    Beside them of how many independent values these are the best. The columns are correlated with
    the residual (N,) without being filtered, which is accurate enough to find a grid.
    """
    (shape,) = effect.shapes
    assert shape.scan is not None
    values = {
        name: np.concatenate([s.values[name][s.segment.kept, joint] for s in signals])[runs.all]
        for name in OWN
    }
    reach = max(float(np.ptp(values["q"])), 1e-3)
    speed = max(float(np.percentile(np.abs(values["dq"]), SLOW_PERCENTILE)), 1e-3)
    highest = min(shape.upper, 2.0 * np.pi * signals[0].segment.cutoff / speed)
    step = max(shape.scan, PHASE_STEP * 2.0 * np.pi / reach)
    grid = np.arange(shape.lower, max(highest, shape.lower + 1e-9), step)
    gains = np.concatenate(list(_scan_gains(effect, values, grid, residual)))
    padded = np.concatenate([[-np.inf], gains, [-np.inf]])
    peaks = np.flatnonzero((gains >= padded[:-2]) & (gains >= padded[2:]))
    best = peaks[np.argsort(-gains[peaks])[:SCAN_PEAKS]]
    around = np.unique(np.clip(best[:, None] + np.arange(-1, 2), 0, len(grid) - 1))
    turns = float(grid[-1] - grid[0]) * reach / (2.0 * np.pi)
    return np.asarray(grid[around][:, None]), max(turns, 1.0)


def _scan_gains(
    effect: Effect, values: Mapping[str, Array], grid: Array, residual: Array
) -> Iterator[Array]:
    """Yield the falls of the sum of squares at parts of a grid."""
    function = EffectFunction(effect)
    for k in range(0, len(grid), CHUNK):
        columns = function.at(values, grid[k : k + CHUNK])
        grams = np.einsum("ang,bng->gab", columns, columns)
        grams += 1e-9 * np.trace(grams, axis1=1, axis2=2)[:, None, None] * np.eye(len(columns))
        products = np.einsum("cng,n->gc", columns, residual)
        yield np.einsum("gc,gc->g", np.linalg.solve(grams, products[..., None])[..., 0], products)
