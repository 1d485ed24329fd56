"""Scan of one shape parameter over its range, for effects whose gain has many narrow peaks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.screening.effect_columns import EffectFunction, SegmentSignals
from lieid_casadi.diagnosis.screening.effect_memory import OWN
from lieid_casadi.effects import Effect

Array = NDArray[np.float64]
CHUNK = 128  # values of a shape parameter that a scan evaluates at once: bounds the memory
KEPT_BYTES = 16 << 20  # columns of a scan that are kept for the residuals of other fits


@dataclass(frozen=True, eq=False)
class ShapeScan:
    """An effect on one joint at many values of its one shape parameter.

    The columns are correlated with a residual at the filtered instants without being filtered
    themselves, which is accurate enough to find candidates for the grid.

    Attributes
    ----------
    effect : Effect
    values : dict
        Signal → (N,) at the instants of the joint's runs.
    grid : (G,)
        Values of the shape parameter.
    """

    effect: Effect
    values: Mapping[str, Array]
    grid: Array

    @classmethod
    def of(
        cls,
        effect: Effect,
        signals: Sequence[SegmentSignals],
        joint: int,
        rows: NDArray[np.intp],
        options: DiagnosisOptions,
    ) -> ShapeScan:
        """Return the scan, with steps that the range of motion resolves.

        Parameters
        ----------
        effect : Effect
        signals : sequence of SegmentSignals
            One per segment.
        joint : int
            From 0.
        rows : (N,) int
            Instants of the runs in the common time line of all segments.
        options : DiagnosisOptions
        """
        (shape,) = effect.shapes
        assert shape.scan is not None
        values = {
            name: np.concatenate([s.values[name][s.segment.kept, joint] for s in signals])[rows]
            for name in OWN
        }
        reach = max(float(np.ptp(values["q"])), 1e-3)
        speed = max(float(np.percentile(np.abs(values["dq"]), options.scan_speed_percentile)), 1e-3)
        highest = min(shape.upper, 2.0 * np.pi * signals[0].segment.cutoff / speed)
        step = max(shape.scan, options.scan_phase_step * 2.0 * np.pi / reach)
        grid = np.arange(shape.lower, max(highest, shape.lower + 1e-9), step)
        return cls(effect, values, grid)

    def peaks(self, residual: Array, options: DiagnosisOptions) -> Array:
        """Return the values (P, 1) with the largest gains for a residual (N,), and neighbours."""
        gains = np.concatenate([self._gains(*part, residual) for part in self._columns()])
        padded = np.concatenate([[-np.inf], gains, [-np.inf]])
        peaks = np.flatnonzero((gains >= padded[:-2]) & (gains >= padded[2:]))
        best = peaks[np.argsort(-gains[peaks])[: options.scan_peaks]]
        around = np.unique(np.clip(best[:, None] + np.arange(-1, 2), 0, len(self.grid) - 1))
        return np.asarray(self.grid[around][:, None])

    def _columns(self) -> Sequence[tuple[Array, Array]] | Iterator[tuple[Array, Array]]:
        """Return columns (c, N, G') and Gram matrices (G', c, c) of parts of the grid."""
        size = 8 * len(self.grid) * len(self.values["q"]) * len(self.effect.coefficients)
        return self._kept if size <= KEPT_BYTES else self._evaluated()

    @cached_property
    def _kept(self) -> list[tuple[Array, Array]]:
        return list(self._evaluated())

    def _evaluated(self) -> Iterator[tuple[Array, Array]]:
        function = EffectFunction(self.effect)
        for k in range(0, len(self.grid), CHUNK):
            columns = function.at(self.values, self.grid[k : k + CHUNK])
            grams = np.einsum("ang,bng->gab", columns, columns)
            grams += 1e-9 * np.trace(grams, axis1=1, axis2=2)[:, None, None] * np.eye(len(columns))
            yield columns, grams

    def _gains(self, columns: Array, grams: Array, residual: Array) -> Array:
        """Return the fall of the sum of squares (G',) of a residual (N,)."""
        products = np.einsum("cng,n->cg", columns, residual)
        solved = np.linalg.solve(grams, products.T[:, :, None])[:, :, 0]
        return np.asarray(np.sum(solved * products.T, axis=1))
