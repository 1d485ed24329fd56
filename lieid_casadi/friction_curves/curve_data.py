"""Data of a friction curve, for averaging a model's columns in the same way as the torque."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled
from lieid_casadi.friction_curves.binning import PairGroups
from lieid_casadi.friction_curves.position_matching import Matching
from lieid_casadi.recording import Processed
from lieid_casadi.robot.robot import Robot

MOST_INSTANTS = 30  # of a point and direction, if columns are averaged over a subset


@dataclass(frozen=True, eq=False)
class CurveData:
    """Segments of motion, pairs of instants in them, and groups of pairs.

    Attributes
    ----------
    robot : Robot
    segments : tuple of Processed
        Their temperatures are relative to ``temperature_mean``.
    load : tuple of (K, n)
        τ_load along each segment, N·m; zero for the other joints.
    matching : Matching
    groups : PairGroups
    friction : (P,)
        Friction torque of each pair of instants, N·m.
    temperature_mean : (n,) or None
        Mean temperature of the training recordings, °C.
    """

    robot: Robot
    segments: tuple[Processed, ...]
    load: tuple[Array, ...]
    matching: Matching
    groups: PairGroups
    friction: Array
    temperature_mean: Array | None

    @property
    def has_temperature(self) -> bool:
        """Whether all segments have a temperature."""
        return all(s.temperature is not None for s in self.segments)

    def columns(
        self, compiled: Compiled, joint: int, shapes: Array, *, thinned: bool = False
    ) -> Array:
        """Return the columns of effects, matched and averaged like the torque.

        The columns are not filtered: near the instants used there is no reversal, and between
        reversals the filter hardly changes them. Effects with memory are evaluated along the
        segments.

        ``compiled``: functions of a model with m effect columns; ``joint``: from 0; ``shapes``
        (s,): shape parameters; ``thinned``: average over a subset of each point's instants, for
        searches.
        """
        average, used = self._thinned if thinned else self._whole
        if compiled.model.states:
            whole = [
                self._along(compiled, k, slice(None), shapes)[s.kept, joint]
                for k, s in enumerate(self.segments)
            ]
            return np.asarray(average @ np.concatenate(whole)[used])
        parts = [
            self._along(compiled, k, rows, shapes)[:, joint]
            for k, rows in enumerate(self._rows(used))
        ]
        return np.asarray(average @ np.concatenate(parts))

    def _along(
        self, compiled: Compiled, number: int, rows: slice | NDArray[np.intp], shapes: Array
    ) -> Array:
        """Return the columns (R, n, m) at rows of a segment's grid."""
        s = self.segments[number]
        return compiled.effect_columns(
            s.q[rows],
            s.dq[rows],
            s.ddq[rows],
            load=self.load[number][rows],
            temperature=None if s.temperature is None else s.temperature[rows],
            time=(s.t - s.t[0])[rows],
            shapes=shapes,
            dead_zone=s.dead_zone,
        )

    @cached_property
    def _difference(self) -> csr_matrix[np.float64]:
        """Matrix (G, M) that averages half the difference of both directions."""
        halves = 0.5 * (self.matching.forward - self.matching.backward)
        return csr_matrix(self.groups.average @ halves)

    @cached_property
    def _whole(self) -> tuple[csr_matrix[np.float64], NDArray[np.intp]]:
        """`_difference` restricted to the samples that it uses (G, U), and their indices (U,)."""
        return _on_used(self._difference)

    @cached_property
    def _thinned(self) -> tuple[csr_matrix[np.float64], NDArray[np.intp]]:
        """The same with at most MOST_INSTANTS per point and direction, weights scaled up."""
        whole = self._difference
        entries, columns, starts = [], [], [0]
        for first, last in zip(whole.indptr[:-1], whole.indptr[1:], strict=True):
            weights, at = whole.data[first:last], whole.indices[first:last]
            order = np.argsort(at, kind="stable")
            weights, at = weights[order], at[order]
            for direction in (weights > 0.0, weights < 0.0):
                own, where = weights[direction], at[direction]
                step = -(-len(own) // MOST_INSTANTS) or 1
                chosen = own[step // 2 :: step]
                if len(chosen):
                    entries.append(chosen * (own.sum() / chosen.sum()))
                    columns.append(where[step // 2 :: step])
            starts.append(sum(len(x) for x in entries))
        some = (np.concatenate(entries), np.concatenate(columns), starts)
        return _on_used(csr_matrix(some, shape=whole.shape))

    def _rows(self, used: NDArray[np.intp]) -> list[NDArray[np.intp]]:
        """Return indices of filtered samples as rows of each segment's grid."""
        ends = np.cumsum([0, *(len(s.filtered_time) for s in self.segments)])
        return [
            np.arange(len(s))[s.kept][used[(used >= a) & (used < b)] - a]
            for s, a, b in zip(self.segments, ends[:-1], ends[1:], strict=True)
        ]


def _on_used(
    matrix: csr_matrix[np.float64],
) -> tuple[csr_matrix[np.float64], NDArray[np.intp]]:
    used = np.unique(matrix.nonzero()[1]).astype(np.intp)
    return csr_matrix(matrix[:, used]), used
