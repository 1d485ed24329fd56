"""Constraints on effect coefficients that make friction dissipative."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse.csgraph import connected_components

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.compiled import Compiled
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed

# fractions of the largest speed, dense near rest where only Coulomb friction acts
SPEEDS = np.array([1e-4, 1e-3, 3e-3, 0.01, 0.02, 0.05, *np.linspace(0.1, 1.0, 19)])
COUPLED_SPEEDS = np.array([-1.0, -0.5, -0.1, -0.01, 0.0, 0.01, 0.1, 0.5, 1.0])
LEVELS = np.array([0.0, 0.5, -0.5, 1.0, -1.0])  # of the largest load or temperature deviation
POSITIONS = 24  # on a grid, for friction that depends on the position
MOST = 20_000  # motions of a group of joints
LATE = 1e6  # s, after warm-up
FAR = 100.0  # turns and seconds between samples: friction with states reaches full sliding


def friction_columns(model: Model) -> Mask:
    """Mark the effect columns (m,) that are friction: of effects with q̇, its sign, or states.

    Offset, armature and springs are not friction and are not constrained.
    """
    return np.array(
        [
            bool({"dq", "sign"} & set(p.effect.signals)) or bool(p.effect.states)
            for p in model.placements
            for _ in p.effect.coefficients
        ],
        dtype=bool,
    )


def dissipation_rows(
    compiled: Compiled,
    shapes: Array,
    *,
    velocity: Array,
    load: Array,
    temperature: Array,
    lower: Array,
    upper: Array,
) -> Array:
    """Return rows (K, m): friction dissipates on a grid of motions iff rows @ coefficients ≥ 0.

    A row is the power of friction over the speed, ``sgn(q̇)·τ_f(q̇)`` in N·m. For joints with
    couplings the powers of all coupled joints are added.
    """
    model = compiled.model
    friction = friction_columns(model)
    rows = [np.zeros((0, len(friction)))]
    groups = coupled_joints(model)
    # of the motions of many joints a part is drawn, which hardly contains those of one alone
    alone = [[j] for group in groups if len(group) > 2 for j in group]
    for group in groups + alone:
        columns, speeds = _columns(
            compiled, group, velocity, shapes, load, temperature, (lower, upper)
        )
        power = np.einsum("gi,gik->gk", speeds[:, group], columns[:, group])
        rows.append(power / np.linalg.norm(speeds[:, group], axis=1)[:, None])
    stacked = np.vstack(rows) * friction
    stacked = np.asarray(stacked[np.abs(stacked).max(axis=1, initial=0.0) > 0.0])
    return _distinct(stacked)


def coupled_joints(model: Model) -> list[list[int]]:
    """Return groups of joints that couplings connect."""
    edges = np.zeros((model.n, model.n))
    for p in model.placements:
        if p.source is not None:
            edges[p.joint, p.source] = 1.0
    count, group = connected_components(edges, directed=False)
    return [np.flatnonzero(group == k).tolist() for k in range(count)]


def largest_speed(model: Model, segments: Sequence[Processed]) -> Array:
    """Return the speed (n,) up to which friction is constrained to dissipate, rad/s.

    It is the velocity limit, or the fastest recorded motion if that is faster.
    """
    recorded = np.max([np.abs(s.dq).max(axis=0) for s in segments], axis=0)
    return np.asarray(np.fmax(model.robot.limit("velocity"), recorded))


def _grid(axes: Sequence[Array]) -> list[Array]:
    """Return all combinations of values, an array (G,) for each axis.

    Of more than `MOST` combinations a part that is drawn at random, the same at each call.
    """
    if np.prod([float(len(axis)) for axis in axes]) <= MOST:
        return [grid.ravel() for grid in np.meshgrid(*axes, indexing="ij")]
    random = np.random.default_rng(0)
    return [random.choice(axis, MOST) for axis in axes]


def _columns(
    compiled: Compiled,
    group: list[int],
    velocity: Array,
    shapes: Array,
    load: Array,
    temperature: Array,
    positions: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Return columns (G, n, m) and speeds (G, n) at all levels of load, temperature and q."""
    model = compiled.model
    here = [p for p in model.placements if p.joint in group]
    needs = {signal for p in here for signal in p.effect.signals}
    loads = LEVELS if "load" in needs else LEVELS[:1]
    warm = LEVELS if "temperature" in needs else LEVELS[:1]
    where = np.linspace(0.0, 1.0, POSITIONS) if "q" in needs else np.array([0.5])
    memory = any(p.effect.states for p in here)
    when = np.array([0.0, LATE]) if "time" in needs and not memory else np.zeros(1)
    single = np.concatenate([SPEEDS, -SPEEDS])
    each = [single] if len(group) == 1 else [COUPLED_SPEEDS] * len(group)
    *parts, a, b, c, time = _grid([*each, loads, warm, where, when])
    dq = np.zeros((len(time), model.n))
    dq[:, group] = np.column_stack(parts)
    moving = dq.any(axis=1)
    dq, a, b, c, time = dq[moving] * velocity, a[moving], b[moving], c[moving], time[moving]
    low, high = positions
    q = low + c[:, None] * (high - low)
    if memory:  # one long motion; its first sample, before any sliding, is left out
        dq, q, a, b, time = (np.concatenate([x[:1], x]) for x in (dq, q, a, b, time))
        q = q + 2.0 * np.pi * FAR * np.cumsum(np.sign(dq), axis=0)
        time = time + FAR * np.arange(len(time))
    columns = compiled.effect_columns(
        q, dq, np.zeros_like(dq), load=a[:, None] * load, temperature=b[:, None] * temperature,
        time=time, shapes=shapes, dead_zone=np.zeros(model.n), joint_effects_only=True,
    )  # fmt: skip
    return (columns[1:], dq[1:]) if memory else (columns, dq)


def _distinct(rows: Array) -> Array:
    """Remove rows that repeat others (odd friction gives the same row in both directions)."""
    if not len(rows):
        return rows
    keys = np.round(rows / np.abs(rows).max(axis=1, keepdims=True), 9)
    _, first = np.unique(keys, axis=0, return_index=True)
    return rows[np.sort(first)]
