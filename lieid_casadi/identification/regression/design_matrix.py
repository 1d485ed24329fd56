"""Regression of a fit: filtered columns and torque, one stack of rows per joint.

Columns that depend on the motion alone are evaluated window by window and may be shared by models
of one robot (`FilteredColumns`).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled
from lieid_casadi.effects import ArmEffect
from lieid_casadi.identification.regression.rows import ChunkedRows
from lieid_casadi.identification.regression.rows import JointRows as JointRows
from lieid_casadi.identification.regression.rows import Rows as Rows
from lieid_casadi.identification.regression.segment_columns import effect_signals, effects_along
from lieid_casadi.model import Model
from lieid_casadi.recording.filtering import Window
from lieid_casadi.recording.processed import Processed


def varying_columns(model: Model) -> NDArray[np.bool_]:
    """Mark the effect columns (m,) that depend on shape parameters or on the load."""
    return np.array(
        [
            bool(p.effect.shapes) or "load" in p.effect.signals or isinstance(p.effect, ArmEffect)
            for p in model.placements
            for _ in p.effect.coefficients
        ],
        dtype=bool,
    )


def has_dry_friction(model: Model) -> NDArray[np.bool_]:
    """Mark the joints (n,) with an effect whose torque is undetermined at rest."""
    dry = np.zeros(model.n, dtype=bool)
    for placement in model.placements:
        if placement.effect.dry or "sign" in placement.effect.signals:
            dry[placement.joint] = True
    return dry


def active_columns(compiled: Compiled) -> list[NDArray[np.intp]]:
    """Return the base columns (a,) that can act on each joint (n)."""
    model, functions = compiled.model, compiled.functions
    acts = np.zeros((model.n, model.base.count), dtype=bool)
    rigid = functions.base_regressor
    acts[rigid.rows, rigid.columns] = True
    position = {int(k): i for i, k in enumerate(model.base.kept)}
    effects = functions.effect_columns
    for row, column in zip(effects.rows, effects.columns, strict=True):
        kept = position.get(10 * model.n + int(column))
        if kept is not None:
            acts[row, kept] = True
    first = 10 * model.n
    for p in model.placements:
        last = first + len(p.effect.coefficients)
        if isinstance(p.effect, ArmEffect):
            rows = p.joint if p.effect.reach == "joint" else slice(None)
            acts[rows, [position[k] for k in range(first, last) if k in position]] = True
        first = last
    return [np.flatnonzero(row) for row in acts]


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


Chunk = list[tuple[int, Window]]  # numbers of segments, and windows of their rows
HELD_BYTES = 128 << 20
CHUNK_BYTES = 32 << 20


class Design:
    """Columns of one model along processed segments.

    Columns that depend on the motion alone are evaluated and filtered once, window by window;
    columns that depend on shape parameters or the load (``varying``) at each call of `rows`.
    Columns of more than ``held`` bytes are not kept: rows are computed in chunks, again for every
    pass over them.

    Parameters
    ----------
    compiled : Compiled
    segments : sequence of Processed
        Each with a torque.
    held : int, optional
        Largest size of columns that are kept, bytes; 128 MB if left out.
    known : sequence of FilteredColumns, optional
        Of each segment, from designs of other models of the robot; columns that are not in them
        are added. Not used where the columns take more than ``held`` bytes.
    """

    def __init__(
        self,
        compiled: Compiled,
        segments: Sequence[Processed],
        *,
        held: int | None = None,
        known: Sequence[FilteredColumns] | None = None,
    ) -> None:
        self.compiled = compiled
        self.model = compiled.model
        self.segments = tuple(segments)
        self._varying = varying_columns(self.model)
        kept = self.model.base.kept - 10 * self.model.n
        self._effects = np.flatnonzero(kept >= 0)  # positions among the base columns
        self._effect_index = kept[kept >= 0]  # columns of the model's effects
        self._active = active_columns(compiled)
        self._use = [_fit_rows(self.model, segment) for segment in self.segments]
        self._torque = [s.filter(_torque(s)) for s in self.segments]
        windows = [(k, w) for k, s in enumerate(self.segments) for w in s.windows]
        width = 8 * sum(len(active) for active in self._active)
        self._chunks = _chunks(windows, width, HELD_BYTES if held is None else held)
        stores = known if known and len(self._chunks) == 1 else [None] * len(self.segments)
        self._constant = [
            MotionColumns(compiled, segment, self.varying, store)
            for segment, store in zip(self.segments, stores, strict=True)
        ]
        self._kept: list[list[Array]] | None = None
        self._rows: Rows | None = None
        self._last: tuple[tuple[bytes, bytes | None], list[Array]] | None = None
        if len(self._chunks) == 1:
            self._kept = self._filtered(self._chunks[0])
            if not self._varying.any():
                self._rows, self._kept = self._stack(self._chunks[0], self._kept, []), None

    def rows(self, shapes: Array, link_parameters: Array | None) -> Rows:
        """Return the equations at given shape parameters and load.

        Parameters
        ----------
        shapes : (s,)
        link_parameters : (10 n,) or (10 n + m,) or None
            Determine the load of load-dependent effects; with effect coefficients where effects
            on the whole arm need them. None means no load.
        """
        if self._rows is not None:
            return self._rows
        varying: list[Array] = []
        if self._varying.any():
            varying = self._varying_blocks(shapes, link_parameters)
        if self._kept is not None:
            return self._stack(self._chunks[0], self._kept, varying)

        def make(k: int) -> Rows:
            return self._stack(self._chunks[k], self._filtered(self._chunks[k]), varying)

        lengths = [[self._use[k][w.rows].sum(axis=0) for k, w in s] for s in self._chunks]
        instants = [sum(w.rows.stop - w.rows.start for _, w in s) for s in self._chunks]
        return ChunkedRows(
            make,
            np.array([np.sum(part, axis=0) for part in lengths], dtype=np.intp),
            np.array(instants, dtype=np.intp),
            self._active,
            self.model.base.count,
            _starts([len(use) for use in self._use]),
        )

    @cached_property
    def varying(self) -> NDArray[np.intp]:
        """Base columns (v,) that depend on shapes or load."""
        return self._effects[self._varying[self._effect_index]]

    def varying_rows(self, shapes: Array, link_parameters: Array | None) -> list[Array]:
        """Return the varying columns per joint (R, v), with the rows of `rows`."""
        blocks = self._varying_blocks(shapes, link_parameters)
        return [self.on_joint(j, [b[:, j] for b in blocks]) for j in range(self.model.n)]

    def on_joint(self, joint: int, values: Sequence[Array]) -> Array:
        """Return filtered values (M, …) of each segment on the rows (R, …) of a joint."""
        used = (own[mask[:, joint]] for own, mask in zip(values, self._use, strict=True))
        return np.concatenate(list(used))

    def columns_of_shape(self, k: int) -> NDArray[np.intp]:
        """Return the positions, among the varying columns, of those of the effect with shape k."""
        owners = [
            number for number, p in enumerate(self.model.placements) for _ in p.effect.coefficients
        ]
        shape_owners = [
            number for number, p in enumerate(self.model.placements) for _ in p.effect.shapes
        ]
        columns = self._effect_index[self._varying[self._effect_index]]
        return np.flatnonzero([owners[column] == shape_owners[k] for column in columns])

    def _varying_blocks(self, shapes: Array, links: Array | None) -> list[Array]:
        """Return the filtered varying columns (M, n, v) of each segment.

        Those of the last call are kept: residual, derivatives and rows of a fit follow each other
        at the same shapes and load.
        """
        key = shapes.tobytes(), None if links is None else links.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, [self._varying_columns(s, shapes, links) for s in self.segments]
        return self._last[1]

    def _varying_columns(self, segment: Processed, shapes: Array, links: Array | None) -> Array:
        """Return the filtered varying columns (M, n, v)."""
        effects = effects_along(self.compiled, segment, shapes, links)
        joints, places = self._varying_pairs
        wanted = self._effect_index[self._varying[self._effect_index]]
        filtered = segment.filter(effects[:, joints, wanted[places]])
        columns = np.zeros((len(filtered), self.model.n, len(wanted)))
        columns[:, joints, places] = filtered
        return columns

    @cached_property
    def _varying_pairs(self) -> tuple[Indices, Indices]:
        """Pairs of a joint and the position of a varying column that acts on it."""
        acts = np.array([np.isin(self.varying, active) for active in self._active])
        joints, places = np.nonzero(acts)
        return joints, places

    def _filtered(self, chunk: Chunk) -> list[list[Array]]:
        """Return the columns that do not vary, for each window and joint (c, m)."""
        threads = min(self.compiled.threads, len(chunk))
        if threads <= 1:
            return [self._constant[k].filtered(window) for k, window in chunk]
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(lambda part: self._constant[part[0]].filtered(part[1]), chunk))

    def _stack(
        self, chunk: Chunk, constant: Sequence[Sequence[Array]], varying: Sequence[Array]
    ) -> Rows:
        """Return the equations of a chunk from its columns.

        Parameters
        ----------
        chunk : list of (int, Window)
        constant : sequence of sequence of (c, m)
            Columns that do not vary, for each window and joint.
        varying : sequence of (M, n, v)
            Varying columns of each segment; empty if there are none.
        """
        firsts = _starts([w.rows.stop - w.rows.start for _, w in chunk])
        joints = [
            self._joint_rows(j, chunk, [values[j] for values in constant], varying, firsts)
            for j in range(self.model.n)
        ]
        owner = [k for k, _ in chunk]
        new = [k for k in range(len(owner)) if k == 0 or owner[k] != owner[k - 1]]
        return Rows(joints, self.model.base.count, firsts[[*new, len(owner)]])

    def _joint_rows(
        self,
        j: int,
        chunk: Chunk,
        constant: Sequence[Array],
        varying: Sequence[Array],
        firsts: Indices,
    ) -> JointRows:
        """Return the equations of joint j; see `_stack`."""
        active = self._active[j]
        constant_at = np.searchsorted(active, self._constant[0].columns[j])
        varying_at = np.flatnonzero(np.isin(active, self.varying))
        chosen = np.flatnonzero(np.isin(self.varying, active))
        use = [self._use[k][w.rows, j] for k, w in chunk]
        matrix = np.zeros((sum(int(mask.sum()) for mask in use), len(active)))
        last = 0
        for (k, window), mask, values in zip(chunk, use, constant, strict=True):
            first, last = last, last + int(mask.sum())
            matrix[first:last, constant_at] = values.T[mask]
            if varying:
                matrix[first:last, varying_at] = varying[k][window.rows][mask, j][:, chosen]
        torque = [self._torque[k][w.rows, j][mask] for (k, w), mask in zip(chunk, use, strict=True)]
        instant = [a + np.flatnonzero(mask) for a, mask in zip(firsts[:-1], use, strict=True)]
        return JointRows(active, matrix, np.concatenate(torque), np.concatenate(instant))


def _chunks(windows: Sequence[tuple[int, Window]], width: int, held: int) -> list[Chunk]:
    """Group windows into chunks: one if all rows take at most ``held`` bytes.

    Parameters
    ----------
    windows : sequence of (int, Window)
        Number of a segment, and a window.
    width : int
        Bytes per row.
    """
    sizes = [width * (w.rows.stop - w.rows.start) for _, w in windows]
    most = held if sum(sizes) <= held else CHUNK_BYTES
    chunks: list[Chunk] = []
    free = 0
    for window, size in zip(windows, sizes, strict=True):
        if not chunks or size > free:
            chunks.append([])
            free = most
        chunks[-1].append(window)
        free -= size
    return chunks


def _starts(lengths: Sequence[int]) -> Indices:
    """Return the first positions of parts of given lengths, and the end of the last."""
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.intp)


def _fit_rows(model: Model, segment: Processed) -> NDArray[np.bool_]:
    """Mark the filtered rows (M, n) that enter a fit: all but those at rest under dry friction."""
    return segment.filtered_moving | ~has_dry_friction(model)


def _torque(segment: Processed) -> Array:
    assert segment.tau is not None  # checked before identification
    return segment.tau
