"""Friction at constant speed, by the effects' own columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.compiled import Compiled

Array = NDArray[np.float64]
LONG_WAY = 1e3  # rad: effects with memory have forgotten where they came from


def steady_columns(
    compiled: Compiled,
    joint: int,
    speed: ArrayLike,
    shapes: Array,
    *,
    load: ArrayLike = 0.0,
    temperature: ArrayLike = 0.0,
    position: ArrayLike = 0.0,
    time: float = 0.0,
) -> Array:
    """Return half the difference of the effects' columns at ±speed (P, m).

    Parameters
    ----------
    joint : int
        From 0; the others are at rest.
    speed : (P,)
        rad/s, positive.
    shapes : (s,)
    load, temperature, position : (P,) or float
        N·m; °C relative to the mean of training; rad.
    time : float
        s since the start.
    """
    speeds = np.atleast_1d(np.asarray(speed, dtype=float))
    ways = np.concatenate([speeds, -speeds])
    # of each way two samples, the first one far behind: what has memory slides into steadiness
    rows, n = 2 * len(ways), compiled.n
    q, dq, forces, warmth = (np.zeros((rows, n)) for _ in range(4))
    dq[:, joint] = np.repeat(ways, 2)
    q[:, joint] = np.repeat(np.tile(np.broadcast_to(position, speeds.shape), 2), 2)
    q[::2, joint] -= np.sign(ways) * LONG_WAY
    forces[:, joint] = np.repeat(np.tile(np.broadcast_to(load, speeds.shape), 2), 2)
    warmth[:, joint] = np.repeat(np.tile(np.broadcast_to(temperature, speeds.shape), 2), 2)
    columns = compiled.effect_columns(
        q, dq, 0.0 * q, load=forces, temperature=warmth, time=np.full(rows, time), shapes=shapes
    )[1::2, joint]
    return np.asarray(0.5 * (columns[: len(speeds)] - columns[len(speeds) :]))
