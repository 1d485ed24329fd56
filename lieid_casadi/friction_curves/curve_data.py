"""What a friction curve was made from, so that a model's columns can be averaged alike."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from lieid_casadi.compiled import Compiled
from lieid_casadi.friction_curves.binning import Groups
from lieid_casadi.friction_curves.position_matching import Matching
from lieid_casadi.recording import Processed
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]
MOST_INSTANTS = 30  # of a point and way, where columns are averaged over some of them


@dataclass(frozen=True, eq=False)
class CurveData:
    """Segments, pairs of instants in them, and groups of pairs.

    Attributes
    ----------
    robot : Robot
    segments : tuple of Processed
        Temperatures relative to ``temperature_mean``.
    load : tuple of (K, n)
        τ_load along each segment; zero for the other joints.
    matching : Matching
    groups : Groups
    friction : (P,)
        Of each pair of instants, N·m.
    temperature_mean : (n,) or None
        °C.
    """

    robot: Robot
    segments: tuple[Processed, ...]
    load: tuple[Array, ...]
    matching: Matching
    groups: Groups
    friction: Array
    temperature_mean: Array | None

    @property
    def has_temperature(self) -> bool:
        """Whether all recordings have a temperature."""
        return all(s.temperature is not None for s in self.segments)

    def columns(
        self, compiled: Compiled, joint: int, shapes: Array, *, thinned: bool = False
    ) -> Array:
        """Return the effects' columns averaged per point (G, m), as the torque is.

        They are taken at the instants themselves: no reversal is in the filter's reach there,
        and between reversals the filter leaves them as they are. Effects with memory are
        followed along the segments. ``thinned`` averages over some of each point's instants,
        for searches: columns are smooth.
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
        """Half the difference of both ways, averaged: (G, M)."""
        halves = 0.5 * (self.matching.forward - self.matching.backward)
        return csr_matrix(self.groups.average @ halves)

    @cached_property
    def _whole(self) -> tuple[csr_matrix[np.float64], NDArray[np.intp]]:
        """`_difference` on the filtered samples that it uses (G, U), and which (U,)."""
        return _on_used(self._difference)

    @cached_property
    def _thinned(self) -> tuple[csr_matrix[np.float64], NDArray[np.intp]]:
        """The same with at most MOST_INSTANTS of each point and way, their weights raised."""
        whole = self._difference
        entries, columns, starts = [], [], [0]
        for first, last in zip(whole.indptr[:-1], whole.indptr[1:], strict=True):
            weights, at = whole.data[first:last], whole.indices[first:last]
            order = np.argsort(at, kind="stable")
            weights, at = weights[order], at[order]
            for way in (weights > 0.0, weights < 0.0):
                own, where = weights[way], at[way]
                step = -(-len(own) // MOST_INSTANTS) or 1
                chosen = own[step // 2 :: step]
                if len(chosen):
                    entries.append(chosen * (own.sum() / chosen.sum()))
                    columns.append(where[step // 2 :: step])
            starts.append(sum(len(x) for x in entries))
        some = (np.concatenate(entries), np.concatenate(columns), starts)
        return _on_used(csr_matrix(some, shape=whole.shape))

    def _rows(self, used: NDArray[np.intp]) -> list[NDArray[np.intp]]:
        """Return filtered samples of all segments as rows of each segment's grid."""
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
