"""Filtered columns that depend on the motion alone, evaluated window by window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled import Compiled
from lieid_casadi.identification.regression.segment_columns import effect_signals
from lieid_casadi.model import Model
from lieid_casadi.recording.filtering import Window
from lieid_casadi.recording.processed import Processed

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
#: A column on a joint in the window that starts at an instant: that instant, the joint, and a link
#: parameter, or a placed effect and its coefficient.
ColumnKey = tuple[int, int, int | tuple[str, str]]
#: Filtered columns (m,) of one segment. Models of one robot with different effects share most.
FilteredColumns = dict[ColumnKey, Array]


class MotionColumns:
    """Base columns of one segment that depend neither on shapes nor on the load.

    Parameters
    ----------
    compiled : Compiled
    segment : Processed
    varying : (v,) int
        Base columns to leave out: those that depend on shapes or load.
    known : FilteredColumns, optional
        Of this segment; columns that are not in it are added.

    Attributes
    ----------
    columns : tuple of (c_i,) int
        Base columns of each joint, without structural zeros.
    """

    def __init__(
        self,
        compiled: Compiled,
        segment: Processed,
        varying: Indices,
        known: FilteredColumns | None = None,
    ) -> None:
        self.segment, self._known = segment, known
        longest = max(w.instants.stop - w.instants.start for w in segment.windows)
        signals = effect_signals(segment, compiled.model.initial_shapes, None)
        self._blocks = compiled.base_blocks(
            segment.q,
            segment.dq,
            segment.ddq,
            time=signals["time"],
            temperature=signals.get("temperature"),
            command_error=signals.get("command_error"),
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
        meanings = _meanings(compiled.model)
        self._names = [(j, meanings[k]) for j, own in enumerate(self.columns) for k in own]

    def filtered(self, window: Window) -> list[Array]:
        """Return the filtered columns of one window, (c_i, m) per joint."""
        if self._known is None:
            return np.split(self._evaluated(window, self._entries), self._ends)
        known, first = self._known, window.instants.start
        keys: list[ColumnKey] = [(first, *name) for name in self._names]
        missing = [k for k, key in enumerate(keys) if key not in known]
        if missing:
            values = self._evaluated(window, self._entries[missing])
            known |= {keys[k]: row for k, row in zip(missing, values, strict=True)}
        rows = window.rows.stop - window.rows.start
        return np.split(np.array([known[key] for key in keys]).reshape(-1, rows), self._ends)

    def _evaluated(self, window: Window, entries: Indices) -> Array:
        """Return some of the filtered columns of one window (c, m)."""
        buffer = self._blocks.buffer()
        first, last = window.instants.start, window.instants.stop
        self._blocks.evaluate(first, last, buffer)
        values = buffer[:, : last - first]
        if len(entries) < len(values):
            values = values[entries]
        return self.segment.filter_window(values, window, axis=1)


def _meanings(model: Model) -> list[int | tuple[str, str]]:
    """Return the link parameter, or the placed effect and coefficient, of each base column."""
    effects = [(p.label, c.name) for p in model.placements for c in p.effect.coefficients]
    every = [*range(10 * model.n), *effects]
    return [every[k] for k in model.base.kept]
