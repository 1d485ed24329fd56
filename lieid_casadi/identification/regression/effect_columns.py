"""Filtered columns of effects on single joints, at any values of their shape parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.effects import Placement
from lieid_casadi.expressions.effect_function import EffectFunction, sign_of
from lieid_casadi.recording import Processed

AT_ONCE = 1 << 17  # values of a column: temporary arrays stay in the cache


def signals_along(segment: Processed, load: Array, error: Array | None) -> dict[str, Array]:
    """Return the signals of effects on single joints by name, (K, n) each.

    ``error`` is that of position control, None without commands.
    """
    shape, temperature = segment.q.shape, segment.temperature
    return {
        "q": segment.q,
        "dq": segment.dq,
        "ddq": segment.ddq,
        "sign": sign_of(segment.dq, segment.dead_zone),
        "load": load,
        "temperature": np.zeros(shape) if temperature is None else temperature,
        "time": np.tile((segment.t - segment.t[0])[:, None], shape[1]),
        "command_error": np.zeros(shape) if error is None else error,
    }


def filtered_columns(
    function: EffectFunction,
    segment: Processed,
    signals: Mapping[str, Array],
    placements: Sequence[Placement],
    grid: Array,
) -> Array:
    """Return the filtered columns (M, P, G, c) of one effect at P places.

    The grid of shape parameters is (G, s), or (P, G, s) with other values at each place.
    """
    places = [(p.joint, p.source) for p in placements]
    size = max(AT_ONCE // (len(segment) * len(places)), 1)
    parts = []
    for first in range(0, grid.shape[-2], size):
        raw = function.columns(signals, places, grid[..., first : first + size, :])
        parts.append(segment.filter(raw.reshape(len(raw), -1)).reshape(-1, *raw.shape[1:]))
    return np.concatenate(parts, axis=2)
