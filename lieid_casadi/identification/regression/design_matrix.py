"""Regression of a fit: filtered columns and torque, one stack of rows per joint.

Columns that depend on the motion alone are evaluated window by window and may be shared by models
of one robot (`FilteredColumns`).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled
from lieid_casadi.compiled.batch_evaluation import BaseBlocks
from lieid_casadi.compiled.compiled_model import Part
from lieid_casadi.effects import ArmEffect
from lieid_casadi.effects.command_delay import CommandDelay
from lieid_casadi.identification.regression.least_squares import (
    Factor,
    Indices,
    JointRows,
    Rows,
    combine,
)
from lieid_casadi.identification.regression.segment_columns import effect_signals, effects_along
from lieid_casadi.model import Model
from lieid_casadi.recording.filtering import Window
from lieid_casadi.recording.processed import Processed

#: A column on a joint: the joint, and a link parameter, or a placed effect and its coefficient.
ColumnKey = tuple[int, int | tuple[str, str]]
#: Filtered columns (M,) of one segment. Models of one robot with different effects share most.
FilteredColumns = dict[ColumnKey, Array]
REVERSAL = 0.5  # periods of the cut-off frequency, for which the filter mixes a reversal with rows


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


def usable_rows(model: Model, segment: Processed) -> NDArray[np.bool_]:
    """Mark the filtered instants (M, n) at which friction is determined: the rows of a fit.

    Dry friction reverses some milliseconds before or after the velocity: links are elastic, and
    simulators make it soft. By as much a delay of commands would be wrong, and with it viscous
    friction, if reversals counted.
    """
    dry, late = has_dry_friction(model), np.zeros(model.n, dtype=bool)
    late[[p.joint for p in model.placements if isinstance(p.effect, CommandDelay)]] = True
    usable = segment.filtered_moving | ~dry & segment.filtered_mask(segment.by_law)
    if (dry & late).any():
        usable &= segment.away_from_reversals(REVERSAL / segment.cutoff) | ~(dry & late)
    return usable


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
    for slot in model.slots:
        effect, joint = slot.placement.effect, slot.placement.joint
        if isinstance(effect, ArmEffect):
            rows = joint if effect.reach == "joint" else slice(None)
            numbers = 10 * model.n + np.arange(slot.columns.start, slot.columns.stop)
            acts[rows, [position[k] for k in numbers if k in position]] = True
    return [np.flatnonzero(row) for row in acts]


def motion_columns(
    compiled: Compiled, segment: Processed, varying: Indices, known: FilteredColumns
) -> list[Array]:
    """Return the filtered base columns (c, M) per joint that depend on the motion alone.

    All but structural zeros and the ``varying`` columns; those that are not ``known`` are added.
    """
    signals = effect_signals(segment, compiled.model.initial_shapes, None)
    meanings = _meanings(compiled.model)
    keys: list[list[ColumnKey]] = [[] for _ in range(compiled.n)]
    parts: tuple[Part, ...] = ("base_links", "base_effects")  # those of the links are often known
    for part in parts:
        blocks = compiled.base_blocks(
            segment.q,
            segment.dq,
            segment.ddq,
            part=part,
            time=signals["time"],
            temperature=signals.get("temperature"),
            command_error=signals.get("command_error"),
            dead_zone=signals["dead_zone"],
            size=max([1, *(w.instants.stop - w.instants.start for w in segment.windows)]),
        )
        missing: dict[ColumnKey, int] = {}
        places = ((j, k) for j, columns in enumerate(blocks.columns) for k in columns)
        for entry, (j, k) in enumerate(places):
            if k not in varying:
                keys[j].append((j, meanings[k]))
                if keys[j][-1] not in known:
                    missing[keys[j][-1]] = entry
        if missing:
            values = _filtered(segment, blocks, [*missing.values()], compiled.threads)
            known |= zip(missing, values, strict=True)
    count = len(segment.filtered_time)
    return [np.array([known[key] for key in own]).reshape(-1, count) for own in keys]


def _filtered(segment: Processed, blocks: BaseBlocks, entries: list[int], threads: int) -> Array:
    """Return filtered values (e, M) of the layout of blocks."""

    def evaluated(window: Window) -> Array:
        buffer = blocks.buffer()
        first, last = window.instants.start, window.instants.stop
        blocks.evaluate(first, last, buffer)
        return segment.filter_window(buffer[entries, : last - first], window, axis=1)

    with ThreadPoolExecutor(max(threads, 1)) as pool:
        return np.concatenate(list(pool.map(evaluated, segment.windows)), axis=1)


def _meanings(model: Model) -> list[int | tuple[str, str]]:
    """Return the link parameter, or the placed effect and coefficient, of each base column."""
    effects = [(p.label, c.name) for p in model.placements for c in p.effect.coefficients]
    every = [*range(10 * model.n), *effects]
    return [every[k] for k in model.base.kept]


class Design:
    """Columns of one model along processed segments with torque.

    Columns that depend on the motion alone are evaluated and filtered once; columns that depend on
    shape parameters or the load (``varying``) at each call of `rows`. ``known`` columns of each
    segment are from designs of other models of the robot; those that are not in them are added.
    """

    def __init__(
        self,
        compiled: Compiled,
        segments: Sequence[Processed],
        *,
        known: Sequence[FilteredColumns] | None = None,
    ) -> None:
        self.compiled = compiled
        self.model = compiled.model
        self.segments = tuple(segments)
        effect = self.model.base.kept - 10 * self.model.n  # effect column of each base column
        varies = varying_columns(self.model)
        #: base columns (v,) that depend on shapes or load
        self.varying = np.array([i for i, k in enumerate(effect) if k >= 0 and varies[k]], np.intp)
        self._wanted = effect[self.varying]
        self._active = active_columns(compiled)
        acts = np.array([np.isin(self.varying, active) for active in self._active])
        self._pairs = np.nonzero(acts)  # joints, and the varying columns that act on them
        self._use = [usable_rows(self.model, s) for s in self.segments]
        self._torque = [s.filtered_torque for s in self.segments]
        lengths = [len(use) for use in self._use]
        self._segments = np.concatenate([[0], np.cumsum(lengths)]).astype(np.intp)
        stores = known or [FilteredColumns() for _ in self.segments]
        parts = [
            motion_columns(compiled, segment, self.varying, store)
            for segment, store in zip(self.segments, stores, strict=True)
        ]
        self._constant = [
            self.on_joint(j, [part[j].T for part in parts]) for j in range(self.model.n)
        ]
        self._rows: Rows | None = None
        self._last: tuple[tuple[bytes, bytes | None], list[Array]] | None = None
        #: of each segment: varying columns (K, a) as evaluated last, and filtered (M, a)
        self._evaluated: list[tuple[Array, Array] | None] = [None] * len(self.segments)

    def rows(self, shapes: Array, link_parameters: Array | None) -> Rows:
        """Return the equations at shapes (s,) and the load by link parameters (None: no load).

        Parameters are (10 n,), or (10 n + m,) with the coefficients that effects on the whole arm
        need.
        """
        if self._rows is not None:
            return self._rows
        varying = self.varying_rows(shapes, link_parameters) if len(self.varying) else None
        joints = [
            self._joint_rows(j, None if varying is None else varying[j])
            for j in range(self.model.n)
        ]
        rows = Rows(joints, self.model.base.count, self._segments)
        if varying is None:  # these rows stay the same
            self._rows, self._constant = rows, []
        return rows

    def _joint_rows(self, j: int, varying: Array | None) -> JointRows:
        active = self._active[j]
        moving = np.isin(active, self.varying)
        matrix = np.zeros((len(self._constant[j]), len(active)))
        matrix[:, ~moving] = self._constant[j]
        if varying is not None:
            matrix[:, moving] = varying[:, np.isin(self.varying, active)]
        used = np.concatenate([use[:, j] for use in self._use])
        torque = self.on_joint(j, [x[:, j] for x in self._torque])
        return JointRows(active, matrix, torque, np.flatnonzero(used))

    def varying_rows(self, shapes: Array, link_parameters: Array | None) -> list[Array]:
        """Return the varying columns per joint (R, v), with the rows of `rows`."""
        blocks = self._varying_blocks(shapes, link_parameters)
        return [self.on_joint(j, [b[:, j] for b in blocks]) for j in range(self.model.n)]

    def on_joint(self, joint: int, values: Sequence[Array]) -> Array:
        """Return filtered values (M, …) of each segment on the rows (R, …) of a joint."""
        used = (own[mask[:, joint]] for own, mask in zip(values, self._use, strict=True))
        return np.concatenate(list(used))

    def columns_on(self, joint: int) -> Indices:
        """Return the positions, among the varying columns, of those of effects on a joint."""
        own = [self.model.columns[k].joint == joint for k in self._wanted]
        return np.flatnonzero(own)

    def _varying_blocks(self, shapes: Array, links: Array | None) -> list[Array]:
        """Return the filtered varying columns (M, n, v) of each segment.

        Those of the last call are kept: residual, derivatives and rows of a fit follow each other
        at the same shapes and load.
        """
        key = shapes.tobytes(), None if links is None else links.tobytes()
        if self._last is None or self._last[0] != key:
            numbers = range(len(self.segments))
            self._last = key, [self._varying_columns(k, shapes, links) for k in numbers]
        return self._last[1]

    def _varying_columns(self, number: int, shapes: Array, links: Array | None) -> Array:
        """Return the filtered varying columns (M, n, v) of a segment.

        Filtered are those that changed since the last call: a search moves one effect at a time.
        """
        segment = self.segments[number]
        effects = effects_along(self.compiled, segment, shapes, links, wanted=self._wanted)
        joints, places = self._pairs
        raw = effects[:, joints, places]
        before = self._evaluated[number]
        if before is None:
            filtered = segment.filter(raw)
        else:
            filtered = before[1].copy()
            changed = (raw != before[0]).any(axis=0)
            filtered[:, changed] = segment.filter(raw[:, changed])
        self._evaluated[number] = raw, filtered
        columns = np.zeros((len(filtered), self.model.n, len(self._wanted)))
        columns[:, joints, places] = filtered
        return columns


def _torque(segment: Processed) -> Array:
    assert segment.tau is not None  # checked before identification
    return segment.tau


def rows_per_independent(segment: Processed) -> float:
    """Return the number of filtered rows per independent one (two per period of the cut-off)."""
    time = segment.filtered_time
    rate = 1.0 / (time[1] - time[0]) if len(time) > 1 else 1.0
    return float(max(1.0, rate / (2.0 * segment.cutoff)))


def with_priors(factor: Factor, design: Design) -> Factor:
    """Return a factor of rows in units of the noise, with those of what is known before any data.

    A prior counts as one independent row; filtered rows that depend on each other count as more
    than they are, and the prior by the same factor.
    """
    model, first = design.model, design.segments[0]
    laws = model.robot.drives or (None,) * model.n
    torque = np.sqrt(np.mean(np.concatenate([_torque(s) for s in design.segments]) ** 2, axis=0))
    own = [(p, c) for p in model.placements for c in p.effect.coefficients]
    rows = []
    for k, column in enumerate(model.base.kept - 10 * model.n):
        if column < 0 or own[column][1].prior is None:
            continue
        joint = own[column][0].joint
        known = own[column][1].prior(first.recording.rate, laws[joint], float(torque[joint]))
        if known is not None:
            mean, spread = known
            row = np.zeros(factor.r.shape[1])
            row[[k, -1]] = np.array([1.0, mean]) * np.sqrt(rows_per_independent(first)) / spread
            rows.append(row)
    return combine([factor, Factor(np.array(rows), 0)], np.ones(2)) if rows else factor
