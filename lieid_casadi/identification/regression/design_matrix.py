"""Regression of a fit: filtered columns and torque, one stack of rows per joint.

Columns that depend on the motion alone are evaluated window by window and may be shared by models
of one robot (`FilteredColumns`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.compiled import Compiled
from lieid_casadi.compiled.batch_evaluation import BaseBlocks
from lieid_casadi.compiled.compiled_model import Part
from lieid_casadi.effects import ArmEffect, Effect, Placement
from lieid_casadi.effects.command_delay import CommandDelay
from lieid_casadi.expressions.effect_function import EffectFunction
from lieid_casadi.identification.regression.least_squares import JointRows, Rows
from lieid_casadi.identification.regression.segment_columns import (
    effect_signals,
    filtered_columns,
    model_along,
    signals_along,
)
from lieid_casadi.model import Model
from lieid_casadi.recording.filtering import Window
from lieid_casadi.recording.processed import Processed

#: A column on a joint: the joint, and a link parameter, or a placed effect and its coefficient;
#: or those of a placed effect at values of its shapes, whose bytes are in place of a coefficient.
ColumnKey = tuple[int, int | tuple[str, str | bytes]]
#: Filtered columns (M,), those of a grid (M, G, c), of one segment. Models of one robot with
#: different effects share most.
FilteredColumns = dict[ColumnKey, Array]
LOAD_STEP = 1e-4  # of the largest torque, for derivatives by the load
REVERSAL = 0.5  # periods of the cut-off frequency, for which the filter mixes a reversal with rows


def varying_columns(model: Model) -> Mask:
    """Mark the effect columns (m,) that depend on shape parameters or on the load."""
    return np.array(
        [
            bool(p.effect.shapes) or "load" in p.effect.signals or isinstance(p.effect, ArmEffect)
            for p in model.placements
            for _ in p.effect.coefficients
        ],
        dtype=bool,
    )


def is_dry(effect: Effect) -> bool:
    """Whether a torque is undetermined at rest: it has the sign of the velocity."""
    return effect.dry or "sign" in effect.signals


def follows_load(effect: Effect) -> bool:
    """Whether a torque is a function of the load that does not change sign with the velocity."""
    return "load" in effect.signals and not is_dry(effect)


def has_dry_friction(model: Model) -> Mask:
    """Mark the joints (n,) with an effect whose torque is undetermined at rest."""
    dry = np.zeros(model.n, dtype=bool)
    dry[[p.joint for p in model.placements if is_dry(p.effect)]] = True
    return dry


def usable_rows(model: Model, segment: Processed) -> Mask:
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


def active_columns(compiled: Compiled) -> list[Indices]:
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
    effects = [(p.label, c.name) for p in compiled.model.placements for c in p.effect.coefficients]
    meanings: list[int | tuple[str, str]] = [*range(10 * compiled.n), *effects]
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
                keys[j].append((j, meanings[compiled.model.base.kept[k]]))
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


@dataclass(frozen=True, eq=False)
class VaryingEffect:
    """A placed effect with columns that depend on shape parameters or on the load.

    ``coefficients``, ``shapes`` and ``columns`` are its places among the model's coefficients,
    shapes and base columns, ``at`` those among the varying columns of a design; ``kept`` are those
    of its coefficients that are base columns.
    """

    placement: Placement
    coefficients: slice
    shapes: Indices
    columns: Indices
    at: Indices
    kept: Indices

    @property
    def uses_load(self) -> bool:
        """Whether its columns depend on the fitted model."""
        return "load" in self.placement.effect.signals or self.of_arm

    @property
    def of_arm(self) -> bool:
        """Whether it is computed along the whole segment."""
        return isinstance(self.placement.effect, ArmEffect)


def grid_key(own: VaryingEffect, grid: Array) -> ColumnKey:
    """Return the key of the columns of an effect on a grid."""
    return own.placement.joint, (own.placement.label, grid.tobytes())


def varying_effects(model: Model) -> tuple[VaryingEffect, ...]:
    """Return the effects of a model with columns that depend on shape parameters or on the load."""
    position = {int(k): i for i, k in enumerate(model.base.kept)}
    varies, found, first = varying_columns(model), [], 0
    for slot in model.slots:
        own = np.arange(slot.columns.start, slot.columns.stop)
        kept = np.array([i for i, k in enumerate(own) if 10 * model.n + k in position], np.intp)
        if len(kept) and varies[own].all():
            columns = np.array([position[10 * model.n + int(k)] for k in own[kept]], np.intp)
            at, first = first + np.arange(len(kept)), first + len(kept)
            shapes = np.arange(slot.shapes.start, slot.shapes.stop)
            found.append(VaryingEffect(slot.placement, slot.columns, shapes, columns, at, kept))
    return tuple(found)


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
        #: effects with columns that depend on shapes or load, and these base columns (v,)
        self.effects = varying_effects(self.model)
        self.varying = np.concatenate([np.zeros(0, np.intp), *(e.columns for e in self.effects)])
        self.of_arm = [e for e in self.effects if e.of_arm]
        #: the others by their labels: one effect on several joints
        self.alike: dict[str, list[VaryingEffect]] = {}
        for effect in self.effects:
            if not effect.of_arm:
                self.alike.setdefault(effect.placement.effect.label, []).append(effect)
        self._active = active_columns(compiled)
        self._use = [usable_rows(self.model, s) for s in self.segments]
        self._torque = [s.filtered_torque for s in self.segments]
        self.lengths = np.sum([use.sum(axis=0) for use in self._use], axis=0)  # rows per joint (n,)
        lengths = [len(use) for use in self._use]
        self._segments = np.concatenate([[0], np.cumsum(lengths)]).astype(np.intp)
        self._known = known or [FilteredColumns() for _ in self.segments]
        parts = [
            motion_columns(compiled, segment, self.varying, store)
            for segment, store in zip(self.segments, self._known, strict=True)
        ]
        self._constant = [
            self.on_joint(j, [part[j].T for part in parts]) for j in range(self.model.n)
        ]
        self._rows: Rows | None = None
        self._functions: dict[str, EffectFunction] = {}
        self._loaded: tuple[bytes, list[dict[str, Array]]] | None = None  # by the load's parameters
        #: rows of effects as evaluated last, by label, with the shapes and load there
        self._last: dict[str, tuple[tuple[bytes, bytes | None], list[Array]]] = {}

    def rows(self, shapes: Array, link_parameters: Array | None) -> Rows:
        """Return the equations at shapes (s,) and the load by link parameters (None: no load).

        Parameters are (10 n,), or (10 n + m,) with coefficients for effects on the whole arm.
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

    def linearized(self, shapes: Array, parameters: Array | None) -> Rows:
        """Return the equations of a step from parameters (10 n + m,), as Gauss and Newton take it.

        A function of a joint's load changes with its links: linear fits at the last load, repeated,
        may oscillate, or settle at a larger error. Of friction, whose sign changes with the
        velocity, little of this is left over a motion.
        """
        rows, links = self.rows(shapes, parameters), 10 * self.model.n
        using = [e for e in self.effects if follows_load(e.placement.effect)]
        if parameters is None or not using or len(parameters) == links:
            return rows
        joints, values = list(rows.joints), self.model.base.combination @ parameters
        for effect in using:
            j, coefficients = effect.placement.joint, parameters[links:][effect.coefficients]
            own, plain = joints[j], rows.joints[j]
            step = LOAD_STEP * max(float(np.abs(plain.torque).max(initial=0.0)), LOAD_STEP)
            grid, both = shapes[effect.shapes][None], (-step, step)
            less, more = (
                self.joint_columns([effect], grid, parameters, beyond=x)[0][:, 0] for x in both
            )
            slope = (more - less) @ coefficients[effect.kept] / (2.0 * step)
            of_links = self.model.base.kept[plain.columns] < links
            moved = slope[:, None] * np.where(of_links, plain.matrix, 0.0)
            torque = own.torque + moved @ values[plain.columns]
            joints[j] = replace(own, matrix=own.matrix + moved, torque=torque)
        return Rows(joints, rows.count, rows.segments)

    def _joint_rows(self, j: int, varying: Array | None) -> JointRows:
        active = self._active[j]
        moving = np.isin(active, self.varying)
        matrix = np.zeros((len(self._constant[j]), len(active)))
        matrix[:, ~moving] = self._constant[j]
        if varying is not None:
            matrix[:, moving] = varying[:, np.isin(self.varying, active)]
        used = np.concatenate([use[:, j] for use in self._use])
        return JointRows(active, matrix, self.torque(j), np.flatnonzero(used))

    def torque(self, joint: int) -> Array:
        """Return the measured torque (R,) on the rows of a joint, filtered, N·m."""
        return self.on_joint(joint, [x[:, joint] for x in self._torque])

    def varying_rows(self, shapes: Array, link_parameters: Array | None) -> list[Array]:
        """Return the varying columns per joint (R, v), with the rows of `rows`."""
        found = [np.zeros((int(count), len(self.varying))) for count in self.lengths]
        for alike in self.alike.values():
            here = self._present(alike, shapes, link_parameters)
            for effect, columns in zip(alike, here, strict=True):
                found[effect.placement.joint][:, effect.at] = columns
        if self.of_arm:
            at = np.concatenate([effect.at for effect in self.of_arm])
            for own, columns in zip(found, self.arm_rows(shapes, link_parameters), strict=True):
                own[:, at] = columns
        return found

    def _present(
        self, alike: Sequence[VaryingEffect], shapes: Array, links: Array | None
    ) -> list[Array]:
        """Return the columns (R, c) of one effect on each of its joints; the last ones are kept."""
        label, key = alike[0].placement.effect.label, self._key(alike, shapes, links)
        if label not in self._last or self._last[label][0] != key:
            grid = np.array([shapes[effect.shapes] for effect in alike])[:, None]
            columns = self.joint_columns(alike, grid, links)
            self._last[label] = key, [each[:, 0] for each in columns]
        return self._last[label][1]

    def slopes(
        self, alike: Sequence[VaryingEffect], shapes: Array, steps: Array, links: Array | None
    ) -> list[Array]:
        """Return the derivatives (R, s, c) of columns by their shapes, by steps forward (s,)."""
        own = np.array([e.shapes for e in alike])
        moves = np.vstack([np.zeros(own.shape[1]), np.eye(own.shape[1])])
        grid = shapes[own][:, None] + steps[own][:, None] * moves
        columns = self.joint_columns(alike, grid, links)
        here = self._key(alike, shapes, links), [each[:, 0] for each in columns]
        self._last[alike[0].placement.effect.label] = here
        pairs = zip(alike, columns, strict=True)
        return [(x[:, 1:] - x[:, :1]) / steps[e.shapes, None] for e, x in pairs]

    def _key(
        self, alike: Sequence[VaryingEffect], shapes: Array, links: Array | None
    ) -> tuple[bytes, bytes | None]:
        """Return what the columns of one effect depend on."""
        own = np.concatenate([shapes[effect.shapes] for effect in alike])
        load = None if links is None or not alike[0].uses_load else links[: 10 * self.model.n]
        return own.tobytes(), None if load is None else load.tobytes()

    def joint_columns(
        self,
        alike: Sequence[VaryingEffect],
        grid: Array,
        links: Array | None,
        *,
        beyond: float = 0.0,
    ) -> list[Array]:
        """Return the columns (R, G, c) of one effect on some joints at values of its shapes.

        The grid is (G, s), or (P, G, s) with other values on each joint. The load of these joints
        is larger by what is ``beyond`` that of the links, N·m.
        """
        function, placements = self._function(alike[0]), [e.placement for e in alike]
        signals = self._signals_at(links if alike[0].uses_load else None)
        if beyond:
            added = beyond * np.isin(np.arange(self.model.n), [p.joint for p in placements])
            signals = [s | {"load": s["load"] + added} for s in signals]
        parts = [
            filtered_columns(function, segment, own, placements, grid)
            for segment, own in zip(self.segments, signals, strict=True)
        ]
        return [
            self.on_joint(e.placement.joint, [p[:, k][..., e.kept] for p in parts])
            for k, e in enumerate(alike)
        ]

    def grid_columns(self, own: VaryingEffect, grid: Array) -> Array:
        """Return the columns (R, G, c) of an effect without load on a grid; they are ``known``."""
        key, function = grid_key(own, grid), self._function(own)
        for segment, signals, store in zip(self.segments, self._signals, self._known, strict=True):
            if key not in store:
                columns = filtered_columns(function, segment, signals, [own.placement], grid)
                store[key] = columns[:, 0]
        return self.on_joint(key[0], [store[key][..., own.kept] for store in self._known])

    def forget_other_grids(self, keys: Collection[ColumnKey]) -> None:
        """Forget the columns of grids but those with some keys, which bounds the memory."""
        for store in self._known:
            of_grids = [k for k in store if isinstance(k[1], tuple) and isinstance(k[1][1], bytes)]
            for key in set(of_grids).difference(keys):
                del store[key]

    def _function(self, own: VaryingEffect) -> EffectFunction:
        effect = own.placement.effect
        if effect.label not in self._functions:
            self._functions[effect.label] = EffectFunction(effect)
        return self._functions[effect.label]

    @cached_property
    def _signals(self) -> list[dict[str, Array]]:
        """Signals of each segment without a load."""
        zero = [np.zeros_like(s.q) for s in self.segments]
        pairs = zip(self.segments, zero, strict=True)
        return [signals_along(s, load, s.command_error) for s, load in pairs]

    def _signals_at(self, links: Array | None) -> list[dict[str, Array]]:
        """Return the signals of each segment, with the load of link parameters; zero without."""
        if links is None:
            return self._signals
        own = links[: 10 * self.model.n]
        if self._loaded is None or self._loaded[0] != own.tobytes():
            motions = [(s.q, s.dq, s.ddq) for s in self.segments]
            loads = [self.compiled.inverse_dynamics(*motion, own) for motion in motions]
            pairs = zip(self._signals, loads, strict=True)
            self._loaded = own.tobytes(), [signals | {"load": load} for signals, load in pairs]
        return self._loaded[1]

    def arm_rows(self, shapes: Array, links: Array | None, *, kept: bool = True) -> list[Array]:
        """Return the columns per joint (R, a) of effects that are computed along a segment."""
        key = shapes.tobytes(), None if links is None else links.tobytes()
        if "" in self._last and self._last[""][0] == key:
            return self._last[""][1]
        wanted = [int(k) for e in self.of_arm for k in e.coefficients.start + e.kept]
        parts = []
        for segment in self.segments:
            raw = np.zeros((len(segment), self.model.n, len(wanted)))
            if links is not None:  # without a load there are no columns either
                own = model_along(self.compiled, segment, shapes, links).arm_columns()
                raw = np.stack([own[k] for k in wanted], axis=-1)
            parts.append(segment.filter(raw.reshape(len(raw), -1)).reshape(-1, *raw.shape[1:]))
        found = [self.on_joint(j, [p[:, j] for p in parts]) for j in range(self.model.n)]
        if kept:
            self._last[""] = key, found
        return found

    def on_joint(self, joint: int, values: Sequence[Array]) -> Array:
        """Return filtered values (M, …) of each segment on the rows (R, …) of a joint."""
        used = (own[mask[:, joint]] for own, mask in zip(values, self._use, strict=True))
        return np.concatenate(list(used))


def rows_per_independent(segment: Processed) -> float:
    """Return the number of filtered rows per independent one (two per period of the cut-off)."""
    time = segment.filtered_time
    rate = 1.0 / (time[1] - time[0]) if len(time) > 1 else 1.0
    return float(max(1.0, rate / (2.0 * segment.cutoff)))
