"""Filtered columns that depend on the motion alone, evaluated window by window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled import Compiled
from lieid_casadi.identification.regression.segment_columns import effect_signals
from lieid_casadi.recording.processing.overlap_windows import Window
from lieid_casadi.recording.processing.process import Processed

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class MotionColumns:
    """Base columns of one segment that depend neither on shapes nor on the load.

    Parameters
    ----------
    compiled : Compiled
    segment : Processed
    varying : (v,) int
        Base columns to leave out: those that depend on shapes or load.

    Attributes
    ----------
    columns : tuple of (c_i,) int
        Base columns of each joint, without structural zeros.
    """

    def __init__(self, compiled: Compiled, segment: Processed, varying: Indices) -> None:
        self.segment = segment
        longest = max(w.instants.stop - w.instants.start for w in segment.windows)
        signals = effect_signals(segment, compiled.model.initial_shapes, None)
        self._blocks = compiled.base_blocks(
            segment.q,
            segment.dq,
            segment.ddq,
            time=signals["time"],
            temperature=signals.get("temperature"),
            dead_zone=signals["dead_zone"],
            size=max(longest, 1),
        )
        plain = [~np.isin(columns, varying) for columns in self._blocks.columns]
        self.columns = tuple(
            np.asarray(columns[mask], dtype=np.intp)
            for columns, mask in zip(self._blocks.columns, plain, strict=True)
        )
        self._entries = np.flatnonzero(np.concatenate(plain))
        self._ends = np.cumsum([len(columns) for columns in self.columns])[:-1]

    def filtered(self, window: Window) -> list[Array]:
        """Return the filtered columns of one window, (c_i, m) per joint."""
        buffer = self._blocks.buffer()
        first, last = window.instants.start, window.instants.stop
        self._blocks.evaluate(first, last, buffer)
        values = buffer[:, : last - first]
        if len(self._entries) < len(values):
            values = values[self._entries]
        return np.split(self.segment.filter_window(values, window, axis=1), self._ends)
