"""Columns of effects at constant speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled

LONG_WAY = 1e3  # rad, after which effects with memory are in steady state


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
    """Return half the difference of the effects' columns at +speed and −speed.

    ``compiled``: functions of a model with n joints and m effect columns; ``joint``: moving joint,
    from 0; the others are at rest; ``speed`` (P,): positive speeds, rad/s; ``shapes`` (s,): shape
    parameters of the model's effects; ``load`` (P,): load torque of the joint, N·m; ``temperature``
    (P,): °C relative to the mean of the training recordings; ``position`` (P,): joint position,
    rad; ``time``: time since the start of the recording, s.
    """
    speeds = np.atleast_1d(np.asarray(speed, dtype=float))
    velocities = np.concatenate([speeds, -speeds])
    # two samples of each velocity, the first one far away: effects with memory reach steady state
    rows, n = 2 * len(velocities), compiled.n
    q, dq, forces, temperatures = (np.zeros((rows, n)) for _ in range(4))
    dq[:, joint] = np.repeat(velocities, 2)
    q[:, joint] = np.repeat(np.tile(np.broadcast_to(position, speeds.shape), 2), 2)
    q[::2, joint] -= np.sign(velocities) * LONG_WAY
    forces[:, joint] = np.repeat(np.tile(np.broadcast_to(load, speeds.shape), 2), 2)
    temperatures[:, joint] = np.repeat(np.tile(np.broadcast_to(temperature, speeds.shape), 2), 2)
    columns = compiled.effect_columns(
        q,
        dq,
        0.0 * q,
        load=forces,
        temperature=temperatures,
        time=np.full(rows, time),
        shapes=shapes,
        joint_effects_only=True,
    )[1::2, joint]
    return np.asarray(0.5 * (columns[: len(speeds)] - columns[len(speeds) :]))
