"""Columns of all candidates on the rows of a recording, in groups."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Addition(Protocol):
    """Anything that may be added to a model: an effect on a joint, or a smooth function."""

    @property
    def joint(self) -> int:
        """The joint (from 0) whose rows it acts on first."""

    @property
    def lower(self) -> tuple[float, ...]:
        """Lower bounds of its coefficients."""

    @property
    def parameters(self) -> int:
        """Number of parameters that it adds to a model."""


T = TypeVar("T", bound=Addition)


@dataclass(frozen=True, eq=False)
class JointColumns:
    """The columns that act on one joint.

    Attributes
    ----------
    columns : (m,) int
        Their indices among all columns.
    matrix : (R_j, m)
    """

    columns: Indices
    matrix: Array


@dataclass(frozen=True, eq=False)
class CandidateColumns(Generic[T]):
    """Columns in groups: one group is one candidate at one point of its shape grid.

    Attributes
    ----------
    owners : tuple of T
        The candidates.
    owner_index, point, start, size : (G,) int
        Of each group: its candidate, its grid point, its first column, its number of columns.
    joints : tuple of JointColumns
        One per joint.
    """

    owners: tuple[T, ...]
    owner_index: Indices
    point: Indices
    start: Indices
    size: Indices
    joints: tuple[JointColumns, ...]

    def owner(self, group: int) -> T:
        """Return the candidate of a group."""
        return self.owners[int(self.owner_index[group])]

    @cached_property
    def count(self) -> int:
        """Number of columns m of all groups."""
        return int(self.size.sum())

    @cached_property
    def parameters(self) -> Array:
        """Number of parameters that each group adds to a model (G,)."""
        each = np.array([c.parameters for c in self.owners])
        return np.asarray(each[self.owner_index], dtype=float)

    @cached_property
    def joint(self) -> Indices:
        """Joint (from 0) whose rows each group acts on first (G,)."""
        return np.array([c.joint for c in self.owners], dtype=np.intp)[self.owner_index]

    @cached_property
    def support(self) -> Array:
        """Effective number of rows (Σc²)²/Σc⁴ of the least supported column of each group (G,)."""
        squares, fourth = np.zeros(self.count), np.zeros(self.count)
        for own in self.joints:
            square = own.matrix * own.matrix
            squares[own.columns] += square.sum(axis=0)
            fourth[own.columns] += np.einsum("rc,rc->c", square, square)
        # a column of zeros, as on a planar arm, does not disqualify the others of its group
        each = np.divide(squares**2, fourth, out=np.full_like(squares, np.inf), where=fourth > 0.0)
        least = np.minimum.reduceat(each, self.start) if self.count else np.zeros(0)
        return np.where(np.isfinite(least), least, 0.0)

    @cached_property
    def inner(self) -> Array:
        """Inner products within groups (k, m): of column c with column c + offset, by offset."""
        width = int(self.size.max(initial=1))
        inner = np.zeros((width, self.count))
        pairs = {int(size): np.triu_indices(size, 1) for size in np.unique(self.size)}
        for own in self.joints:
            inner[0, own.columns] += np.einsum("rc,rc->c", own.matrix, own.matrix)
            for start, group in self._several(own):
                row, column = pairs[group.shape[1]]
                inner[column - row, start + row] += (group.T @ group)[row, column]
        return inner

    def _several(self, own: JointColumns) -> Iterator[tuple[int, Array]]:
        """Yield first index and columns (R_j, k) of each group of several columns on a joint."""
        at = np.searchsorted(own.columns, self.start)
        here = np.flatnonzero((self.size > 1) & np.isin(self.start, own.columns))
        for start, size, first in zip(self.start[here], self.size[here], at[here], strict=True):
            yield int(start), own.matrix[:, first : first + size]

    def inner_with(self, group: int) -> Array:
        """Return the inner products (m, k) of all columns with those of a group."""
        columns = self.columns_of(group)
        products = np.zeros((self.count, len(columns)))
        for own, dense in zip(self.joints, self.dense(group), strict=True):
            if columns[0] in own.columns:
                products[own.columns] += own.matrix.T @ dense
        return products

    def along(self, basis: Array, ends: Indices) -> Array:
        """Return the coordinates (p, m) of the projections of all columns onto a span.

        Parameters
        ----------
        basis : (R, p)
            Orthonormal.
        ends : (n + 1,) int
            Joint j has rows ends[j] to ends[j + 1] of the basis.
        """
        projected = np.zeros((basis.shape[1], self.count))
        for j, own in enumerate(self.joints):
            projected[:, own.columns] += basis[ends[j] : ends[j + 1]].T @ own.matrix
        return projected

    def along_model(self, basis: Array, ends: Indices) -> tuple[Array, Array]:
        """Return `along` of a model's basis, and `inner_along` of that; the last result is kept."""
        if not self._model_spans or self._model_spans[0][0] is not basis:
            along = self.along(basis, ends)
            self._model_spans[:] = [(basis, along, self.inner_along(along))]
        return self._model_spans[0][1:]

    @cached_property
    def _model_spans(self) -> list[tuple[Array, Array, Array]]:
        return []

    def inner_along(self, along: Array) -> Array:
        """Return inner products within groups (k, m), as `inner`, of coordinates (p, m)."""
        inner = np.zeros_like(self.inner)
        for offset in range(len(inner)):
            count = self.count - offset
            inner[offset, :count] = np.einsum("pc,pc->c", along[:, :count], along[:, offset:])
        return inner

    @cached_property
    def lower_bounds(self) -> Array:
        """Lower bound of the coefficient of each column (m,)."""
        return np.array([lower for k in self.owner_index for lower in self.owners[k].lower])

    def columns_of(self, group: int) -> Indices:
        """Return the indices of a group's columns."""
        return np.arange(self.start[group], self.start[group] + self.size[group])

    def dense(self, group: int) -> list[Array]:
        """Return a group's columns on the rows of each joint: (R_j, k) each."""
        wanted = self.columns_of(group)
        found = []
        for own in self.joints:
            dense = np.zeros((own.matrix.shape[0], len(wanted)))
            at = np.searchsorted(own.columns, wanted)
            here = at < len(own.columns)
            here[here] = own.columns[at[here]] == wanted[here]
            dense[:, here] = own.matrix[:, at[here]]
            found.append(dense)
        return found

    def stacked(self, group: int) -> Array:
        """Return a group's columns on the rows of all joints (R, k)."""
        return np.concatenate(self.dense(group))

    def of_owners(self, wanted: Sequence[int] | Indices) -> CandidateColumns[T]:
        """Return the columns of some candidates, given by their positions, groups in this order."""
        kept = np.isin(self.owner_index, np.asarray(wanted, dtype=np.intp))
        columns = np.repeat(kept, self.size)
        position = np.cumsum(columns) - 1
        joints = []
        for own in self.joints:
            here = columns[own.columns]
            joints.append(JointColumns(position[own.columns[here]], own.matrix[:, here]))
        return CandidateColumns(
            self.owners,
            self.owner_index[kept],
            self.point[kept],
            position[self.start[kept]],
            self.size[kept],
            tuple(joints),
        )

    def whitened(self, noise: Sequence[Noise], runs: Sequence[Runs]) -> CandidateColumns[T]:
        """Return the columns with the rows of each joint whitened."""
        joints = tuple(
            JointColumns(own.columns, each.whiten(own.matrix, run))
            for own, each, run in zip(self.joints, noise, runs, strict=True)
        )
        return replace(self, joints=joints)


def assemble_columns(
    owners: Sequence[T],
    owner_index: Sequence[int],
    point: Sequence[int],
    size: Sequence[int],
    on_joint: Sequence[Sequence[tuple[int, Array]]],
    runs: Sequence[Runs],
) -> CandidateColumns[T]:
    """Assemble columns from the pieces of each joint.

    Parameters
    ----------
    owners : sequence of T
    owner_index, point, size : sequence of int, length G
        Of each group: its candidate, grid point and number of columns.
    on_joint : sequence of sequences of (int, (N_j, m))
        For each joint the index of the first column, and the columns.
    runs : sequence of Runs
        One per joint.
    """
    sizes = np.array(size, dtype=np.intp)
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)[:-1]
    return CandidateColumns(
        tuple(owners),
        np.array(owner_index, dtype=np.intp),
        np.array(point, dtype=np.intp),
        start,
        sizes,
        tuple(_joined(p, run.count) for p, run in zip(on_joint, runs, strict=True)),
    )


def _joined(pieces: Sequence[tuple[int, Array]], rows: int) -> JointColumns:
    if not pieces:
        return JointColumns(np.zeros(0, dtype=np.intp), np.zeros((rows, 0)))
    columns = [np.arange(first, first + matrix.shape[1]) for first, matrix in pieces]
    return JointColumns(np.concatenate(columns), np.concatenate([m for _, m in pieces], axis=1))
