"""The regression behind a fit: filtered columns and torque, one stack of rows per joint."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled import Compiled
from lieid_casadi.effects import ArmEffect
from lieid_casadi.identification.regression.motion_columns import PlainColumns
from lieid_casadi.identification.regression.rows import JointRows as JointRows
from lieid_casadi.identification.regression.rows import LongRows
from lieid_casadi.identification.regression.rows import Rows as Rows
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.model import Model
from lieid_casadi.recording.processing.overlap_windows import Window
from lieid_casadi.recording.processing.process import Processed

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Stretch = list[tuple[int, Window]]  # number of a segment, and a window of its rows
HELD_BYTES = 128 << 20
STRETCH_BYTES = 32 << 20


class Design:
    """Columns of one model along processed segments.

    Rigid columns and plain effects are evaluated and filtered once, window by window; effects
    with shape parameters or load dependence anew for each call of `rows`. Beyond ``held`` bytes
    nothing is kept: rows are made in stretches, anew for every pass over them.

    Parameters
    ----------
    compiled : Compiled
    segments : sequence of Processed
        Each with a torque.
    held : int, optional
        Bytes of columns that may be kept; 128 MB if left out.
    """

    def __init__(
        self, compiled: Compiled, segments: Sequence[Processed], *, held: int | None = None
    ) -> None:
        self.compiled = compiled
        self.model = compiled.model
        self.segments = tuple(segments)
        self._varying = varying_columns(self.model)
        kept = self.model.base.kept - 10 * self.model.n
        self._effects = np.flatnonzero(kept >= 0)  # positions among the base columns
        self._effect_index = kept[kept >= 0]  # columns of the model's effects
        self._active = _active_columns(compiled)
        self._use = [_fit_rows(self.model, segment) for segment in self.segments]
        self._torque = [s.filter(_torque(s)) for s in self.segments]
        self._plain = [PlainColumns(compiled, s, self.varying) for s in self.segments]
        windows = [(k, w) for k, s in enumerate(self.segments) for w in s.windows]
        width = 8 * sum(len(active) for active in self._active)
        self._stretches = _stretches(windows, width, HELD_BYTES if held is None else held)
        self._kept: list[list[Array]] | None = None
        self._rows: Rows | None = None
        if len(self._stretches) == 1:
            self._kept = self._filtered(self._stretches[0])
            if not self._varying.any():
                self._rows, self._kept = self._stack(self._stretches[0], self._kept, []), None

    def rows(self, shapes: Array, link_parameters: Array | None) -> Rows:
        """Return the equations for given shape parameters and link parameters (10 n,).

        Link parameters, with the effects' coefficients after them (10 n + m,) where effects on
        the whole arm need those, give the load of load-dependent effects; None means no load yet.
        """
        if self._rows is not None:
            return self._rows
        fresh: list[Array] = []
        if self._varying.any():
            fresh = [self._fresh(s, shapes, link_parameters) for s in self.segments]
        if self._kept is not None:
            return self._stack(self._stretches[0], self._kept, fresh)

        def make(k: int) -> Rows:
            return self._stack(self._stretches[k], self._filtered(self._stretches[k]), fresh)

        lengths = [[self._use[k][w.rows].sum(axis=0) for k, w in s] for s in self._stretches]
        instants = [sum(w.rows.stop - w.rows.start for _, w in s) for s in self._stretches]
        return LongRows(
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
        """Return the varying columns alone, per joint (R, v), rows as in `rows`."""
        blocks = [self._fresh(s, shapes, link_parameters) for s in self.segments]
        return [
            np.concatenate([b[m[:, j], j] for b, m in zip(blocks, self._use, strict=True)])
            for j in range(self.model.n)
        ]

    def columns_of_shape(self, k: int) -> NDArray[np.intp]:
        """Return which varying columns belong to the effect of shape k."""
        owners = [
            number for number, p in enumerate(self.model.placements) for _ in p.effect.coefficients
        ]
        shape_owners = [
            number for number, p in enumerate(self.model.placements) for _ in p.effect.shapes
        ]
        columns = self._effect_index[self._varying[self._effect_index]]
        return np.flatnonzero([owners[column] == shape_owners[k] for column in columns])

    def _fresh(self, segment: Processed, shapes: Array, links: Array | None) -> Array:
        """Return the filtered varying columns (M, n, v)."""
        effects = effects_along(self.compiled, segment, shapes, links)
        joints, places = self._varying_pairs
        wanted = self._effect_index[self._varying[self._effect_index]]
        filtered = segment.filter(effects[:, joints, wanted[places]])
        fresh = np.zeros((len(filtered), self.model.n, len(wanted)))
        fresh[:, joints, places] = filtered
        return fresh

    @cached_property
    def _varying_pairs(self) -> tuple[Indices, Indices]:
        """Joints, and which of the varying columns act on them."""
        acts = np.array([np.isin(self.varying, active) for active in self._active])
        joints, places = np.nonzero(acts)
        return joints, places

    def _filtered(self, stretch: Stretch) -> list[list[Array]]:
        """Return the plain columns of each window, per joint (c, m)."""
        threads = min(self.compiled.threads, len(stretch))
        if threads <= 1:
            return [self._plain[k].filtered(window) for k, window in stretch]
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(lambda part: self._plain[part[0]].filtered(part[1]), stretch))

    def _stack(
        self, stretch: Stretch, plain: Sequence[Sequence[Array]], fresh: Sequence[Array]
    ) -> Rows:
        use = [self._use[k][w.rows] for k, w in stretch]
        torque = [self._torque[k][w.rows] for k, w in stretch]
        firsts = _starts([len(mask) for mask in use])
        joints = []
        for j, active in enumerate(self._active):
            own, varying = self._plain[0].columns[j], np.flatnonzero(np.isin(active, self.varying))
            place = np.searchsorted(active, own)
            chosen = np.flatnonzero(np.isin(self.varying, active))
            rows = [mask[:, j] for mask in use]
            matrix = np.zeros((sum(int(mask.sum()) for mask in rows), len(active)))
            last = 0
            for (k, window), mask, values in zip(stretch, rows, plain, strict=True):
                first, last = last, last + int(mask.sum())
                matrix[first:last, place] = values[j].T[mask]
                if fresh:
                    part = fresh[k][window.rows]
                    matrix[first:last, varying] = part[mask, j][:, chosen]
            instant = [a + np.flatnonzero(m) for a, m in zip(firsts[:-1], rows, strict=True)]
            joints.append(
                JointRows(
                    active,
                    matrix,
                    np.concatenate([t[m, j] for t, m in zip(torque, rows, strict=True)]),
                    np.concatenate(instant),
                )
            )
        owner = [k for k, _ in stretch]
        new = [k for k in range(len(owner)) if k == 0 or owner[k] != owner[k - 1]]
        return Rows(joints, self.model.base.count, firsts[[*new, len(owner)]])


def _stretches(windows: Sequence[tuple[int, Window]], width: int, held: int) -> list[Stretch]:
    """Gather windows (segment, window): one stretch if all rows are within ``held`` bytes."""
    sizes = [width * (w.rows.stop - w.rows.start) for _, w in windows]
    most = held if sum(sizes) <= held else STRETCH_BYTES
    stretches: list[Stretch] = []
    room = 0
    for window, size in zip(windows, sizes, strict=True):
        if not stretches or size > room:
            stretches.append([])
            room = most
        stretches[-1].append(window)
        room -= size
    return stretches


def _starts(lengths: Sequence[int]) -> Indices:
    """Return where parts of given lengths begin, and the last one's end."""
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.intp)


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
    """Mark the joints (n,) with an effect that is undetermined at rest."""
    dry = np.zeros(model.n, dtype=bool)
    for placement in model.placements:
        if placement.effect.dry or "sign" in placement.effect.signals:
            dry[placement.joint] = True
    return dry


class EffectArrays(TypedDict, total=False):
    """Signals of effects along a segment, as keywords of `Compiled`."""

    shapes: Array
    dead_zone: Array
    time: Array
    load: Array
    temperature: Array


def _fit_rows(model: Model, segment: Processed) -> NDArray[np.bool_]:
    """Mark the filtered rows (M, n) that may enter a fit: not at rest under dry friction."""
    return segment.filtered_moving | ~has_dry_friction(model)


def _active_columns(compiled: Compiled) -> list[NDArray[np.intp]]:
    """Return for each joint the base columns that can act on it."""
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


def _torque(segment: Processed) -> Array:
    assert segment.tau is not None  # checked where recordings enter a fit
    return segment.tau
