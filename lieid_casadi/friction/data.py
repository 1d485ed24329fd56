"""What a friction curve was made from, so that a model's columns can be averaged alike."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from lieid_casadi.compiled import Compiled
from lieid_casadi.friction.bins import Groups
from lieid_casadi.friction.matching import Matching
from lieid_casadi.recording import Processed
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]


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

    def columns(self, compiled: Compiled, joint: int, shapes: Array) -> Array:
        """Return the effects' columns averaged per point (G, m), as the torque is.

        They are taken at the instants themselves: no reversal is in the filter's reach there,
        and between reversals the filter leaves them as they are. Effects with memory are
        followed along the segments.
        """
        if compiled.model.states:
            whole = [
                self._along(compiled, k, slice(None), shapes)[s.kept, joint]
                for k, s in enumerate(self.segments)
            ]
            return np.asarray(self._average @ np.concatenate(whole)[self._used])
        parts = [
            self._along(compiled, k, rows, shapes)[:, joint]
            for k, rows in enumerate(self._used_rows)
        ]
        return np.asarray(self._average @ np.concatenate(parts))

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
    def _used(self) -> NDArray[np.intp]:
        """Filtered samples that a point is made of (U,)."""
        return np.unique(self._difference.nonzero()[1]).astype(np.intp)

    @cached_property
    def _average(self) -> csr_matrix[np.float64]:
        """`_difference` on the used samples: (G, U)."""
        return csr_matrix(self._difference[:, self._used])

    @cached_property
    def _used_rows(self) -> list[NDArray[np.intp]]:
        """Used samples of each segment as rows of its grid."""
        ends = np.cumsum([0, *(len(s.filtered_time) for s in self.segments)])
        return [
            np.arange(len(s))[s.kept][self._used[(self._used >= a) & (self._used < b)] - a]
            for s, a, b in zip(self.segments, ends[:-1], ends[1:], strict=True)
        ]
