"""Equations of a regression per joint: in memory, or in chunks that are computed on demand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array

if TYPE_CHECKING:
    from lieid_casadi.identification.regression.least_squares import Factor

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class JointRows:
    """One joint's equations ``torque = matrix @ β[columns]``.

    Attributes
    ----------
    columns : (c,) int
        Base columns that act on this joint: of the links from it on, and of its effects.
    matrix : (R, c)
    torque : (R,)
        N·m.
    instant : (R,) int
        Position of each row on the common time line of all segments.
    """

    columns: Indices
    matrix: Array
    torque: Array
    instant: Indices


class Rows:
    """Equations of all joints.

    Parameters
    ----------
    joints : sequence of JointRows
    count : int
        Number of base columns p.
    segments : (k + 1,) int
        First instant of each segment, and the number of instants.
    """

    def __init__(self, joints: Sequence[JointRows], count: int, segments: Indices) -> None:
        self._joints: tuple[JointRows, ...] | None = tuple(joints)
        self.count = count
        self.segments = segments
        self.unweighted: list[Factor] | None = None  # cache of `least_squares.joint_factors`

    @property
    def joints(self) -> tuple[JointRows, ...]:
        """Equations of each joint."""
        assert self._joints is not None
        return self._joints

    @property
    def lengths(self) -> Indices:
        """Number of rows of each joint (n,)."""
        return np.array([len(joint.torque) for joint in self.joints], dtype=np.intp)

    @property
    def columns(self) -> tuple[Indices, ...]:
        """Base columns of each joint."""
        return tuple(joint.columns for joint in self.joints)

    def chunks(self) -> Iterator[tuple[Rows, list[slice]]]:
        """Yield parts consecutive in time, with the slices of each joint's rows that they hold.

        Instants of a part begin at 0. Recordings that fit into memory are one part.
        """
        yield self, [slice(0, length) for length in self.lengths]

    def residuals(self, values: Array) -> list[Array]:
        """Return measured − predicted torque per joint (R,)."""
        return self._collected(lambda joint: joint.torque - joint.matrix @ values[joint.columns])

    def on_time_line(self, values: Array) -> Array:
        """Return the residuals (instants, n) on the common time line, NaN where there is no row."""
        line = np.full((int(self.segments[-1]), len(self.columns)), np.nan)
        first = 0
        for part, _ in self.chunks():
            for j, joint in enumerate(part.joints):
                residual = joint.torque - joint.matrix @ values[joint.columns]
                line[first + joint.instant, j] = residual
            first += int(part.segments[-1])
        return line

    def predicted(self, values: Array) -> Array:
        """Return the predicted torque of all rows, one joint after another."""
        return np.concatenate(self._collected(lambda joint: joint.matrix @ values[joint.columns]))

    def _collected(self, of: Callable[[JointRows], Array]) -> list[Array]:
        parts = [[of(joint) for joint in part.joints] for part, _ in self.chunks()]
        return [np.concatenate(joint) for joint in zip(*parts, strict=True)]


class ChunkedRows(Rows):
    """Equations that do not fit into memory: each chunk is computed when it is needed.

    Parameters
    ----------
    make : callable
        Number of a chunk to its rows.
    lengths : (chunks, n) int
        Number of rows of each joint.
    instants : (chunks,) int
        Number of instants.
    columns : sequence of (c,) int
        Base columns of each joint.
    count, segments
        As for `Rows`.
    """

    def __init__(
        self,
        make: Callable[[int], Rows],
        lengths: Indices,
        instants: Indices,
        columns: Sequence[Indices],
        count: int,
        segments: Indices,
    ) -> None:
        super().__init__((), count, segments)
        self._joints = None
        self._make, self._lengths, self._instants = make, lengths, instants
        self._columns = tuple(columns)

    @property
    def joints(self) -> tuple[JointRows, ...]:
        """Equations of each joint, all in memory."""
        if self._joints is None:
            firsts = np.cumsum(self._instants) - self._instants
            parts = [part.joints for part, _ in self.chunks()]
            self._joints = tuple(_joined(one, firsts) for one in zip(*parts, strict=True))
        return self._joints

    @property
    def lengths(self) -> Indices:
        """Number of rows of each joint (n,)."""
        return np.asarray(self._lengths.sum(axis=0))

    @property
    def columns(self) -> tuple[Indices, ...]:
        """Base columns of each joint."""
        return self._columns

    def chunks(self) -> Iterator[tuple[Rows, list[slice]]]:
        """Yield one chunk after another; see `Rows`."""
        ends = np.cumsum(self._lengths, axis=0)
        for k, (lengths, end) in enumerate(zip(self._lengths, ends, strict=True)):
            where = [slice(int(b - m), int(b)) for m, b in zip(lengths, end, strict=True)]
            yield self._make(k), where


def _joined(parts: Sequence[JointRows], firsts: Indices) -> JointRows:
    return JointRows(
        parts[0].columns,
        np.concatenate([part.matrix for part in parts]),
        np.concatenate([part.torque for part in parts]),
        np.concatenate([part.instant + a for part, a in zip(parts, firsts, strict=True)]),
    )
