"""The regression behind a fit: filtered columns and torque, one stack of rows per joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled import Compiled
from lieid_casadi.model import Model
from lieid_casadi.recording.processing import Processed

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointRows:
    """One joint's equations ``torque = matrix @ β[columns]``.

    Attributes
    ----------
    columns : (c,) int
        Base columns that act on this joint: links from it on, and its own effects.
    matrix : (R, c)
    torque : (R,)
        N·m.
    instant : (R,) int
        Row's position in the common time line of all segments.
    """

    columns: NDArray[np.intp]
    matrix: Array
    torque: Array
    instant: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Rows:
    """All joints' equations.

    ``segments`` holds the first instant of each segment and, last, the number of instants.
    """

    joints: tuple[JointRows, ...]
    count: int
    segments: NDArray[np.intp]

    def residuals(self, values: Array) -> list[Array]:
        """Return measured − predicted torque per joint (R,)."""
        return [rows.torque - rows.matrix @ values[rows.columns] for rows in self.joints]

    def predicted(self, values: Array) -> Array:
        """Return the predicted torque of all rows, joint after joint."""
        return np.concatenate([rows.matrix @ values[rows.columns] for rows in self.joints])


class Design:
    """Columns of one model along processed segments.

    Rigid columns and plain effects are evaluated and filtered once; effects with shape
    parameters or load dependence are evaluated anew for each call of `rows`.

    Parameters
    ----------
    compiled : Compiled
    segments : sequence of Processed
        Each with a torque.
    """

    def __init__(self, compiled: Compiled, segments: Sequence[Processed]) -> None:
        self.compiled = compiled
        self.model = compiled.model
        self.segments = tuple(segments)
        self._varying = varying_columns(self.model)
        kept = self.model.base.kept - 10 * self.model.n
        self._effects = np.flatnonzero(kept >= 0)  # positions among the base columns
        self._effect_index = kept[kept >= 0]  # columns of the model's effects
        self._active = _active_columns(compiled)
        self._use = [_fit_rows(self.model, segment) for segment in self.segments]
        shapes, load = self.model.initial_shapes, None
        self._fixed = [self._columns(s, shapes, load, every=True) for s in self.segments]
        self._torque = [s.filter(_torque(s)) for s in self.segments]

    def rows(self, shapes: Array, link_parameters: Array | None) -> Rows:
        """Return the equations for given shape parameters and link parameters (10 n,).

        Link parameters give the load of load-dependent effects; None means no load yet.
        """
        blocks = self._fixed
        if self._varying.any():
            blocks = [
                self._replaced(fixed, segment, shapes, link_parameters)
                for fixed, segment in zip(self._fixed, self.segments, strict=True)
            ]
        return self._stack(blocks)

    @cached_property
    def varying(self) -> NDArray[np.intp]:
        """Base columns (v,) that depend on shapes or load."""
        return self._effects[self._varying[self._effect_index]]

    def varying_rows(self, shapes: Array, link_parameters: Array | None) -> list[Array]:
        """Return the varying columns alone, per joint (R, v), rows as in `rows`."""
        blocks = [self._columns(s, shapes, link_parameters, every=False) for s in self.segments]
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

    def _replaced(
        self, fixed: Array, segment: Processed, shapes: Array, links: Array | None
    ) -> Array:
        block = fixed.copy()
        varying = self._varying[self._effect_index]
        fresh = self._columns(segment, shapes, links, every=False)
        block[:, :, self._effects[varying]] = fresh
        return block

    def _columns(
        self, segment: Processed, shapes: Array, links: Array | None, *, every: bool
    ) -> Array:
        """Return filtered base columns (M, n, p), or the varying effects' alone."""
        load = None
        if links is not None:
            load = self.compiled.inverse_dynamics(segment.q, segment.dq, segment.ddq, links)
        signals = effect_signals(segment, shapes, load)
        effects = self.compiled.effect_columns(segment.q, segment.dq, segment.ddq, **signals)
        if not every:
            wanted = self._effect_index[self._varying[self._effect_index]]
            return segment.filter(effects[:, :, wanted])
        base = self.compiled.rigid_base_regressor(segment.q, segment.dq, segment.ddq)
        base[:, :, self._effects] = effects[:, :, self._effect_index]
        return segment.filter(base)

    def _stack(self, blocks: Sequence[Array]) -> Rows:
        lengths = [len(block) for block in blocks]
        starts = np.concatenate([[0], np.cumsum(lengths)]).astype(np.intp)
        joints = []
        for j in range(self.model.n):
            active = self._active[j]
            use = [mask[:, j] for mask in self._use]
            matrix = [b[m, j][:, active] for b, m in zip(blocks, use, strict=True)]
            torque = [t[m, j] for t, m in zip(self._torque, use, strict=True)]
            instant = [s + np.flatnonzero(m) for s, m in zip(starts[:-1], use, strict=True)]
            joints.append(
                JointRows(
                    active, np.concatenate(matrix), np.concatenate(torque), np.concatenate(instant)
                )
            )
        return Rows(tuple(joints), self.model.base.count, starts)


def varying_columns(model: Model) -> NDArray[np.bool_]:
    """Mark the effect columns (m,) that depend on shape parameters or on the load."""
    return np.array(
        [
            bool(p.effect.shapes) or "load" in p.effect.signals
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


def effect_signals(segment: Processed, shapes: Array, load: Array | None) -> EffectArrays:
    """Return the signals that effects see along a segment."""
    signals: EffectArrays = {
        "shapes": shapes,
        "dead_zone": segment.dead_zone,
        "time": segment.t - segment.t[0],
    }
    if load is not None:
        signals["load"] = load
    if segment.temperature is not None:
        signals["temperature"] = segment.temperature
    return signals


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
    return [np.flatnonzero(row) for row in acts]


def _torque(segment: Processed) -> Array:
    assert segment.tau is not None  # checked where recordings enter a fit
    return segment.tau
