"""Hysteresis of any form: a superposition of stops, each of which turns back within its own width.

Every hysteresis that depends on the sequence of a signal's reversals, and not on its rate, is
approximated by a weighted sum of stop operators of different widths (Prandtl–Ishlinskii; Brokate,
Sprekels, Hysteresis and Phase Transitions, 1996).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def stops(signal: Array, widths: Array) -> Array:
    """Return the stop operators z ← min(max(z + Δx, −w), w) of signals, from zero on.

    Two such steps in succession are again a shift that is limited to an interval. The steps are
    therefore composed within blocks of √K samples, in all blocks at once; then the blocks are
    linked.

    Parameters
    ----------
    signal : (K, n)
        x at each instant.
    widths : (n, w)
        Largest values of z, above zero.

    Returns
    -------
    (K, n, w) array
        z at each instant.
    """
    steps = np.diff(signal, axis=0, prepend=signal[:1])
    count = len(steps)
    block = max(int(np.sqrt(count)), 1)
    blocks = -(-count // block)
    padded = np.zeros((blocks * block, signal.shape[1]))
    padded[:count] = steps
    shift = np.repeat(padded.reshape(blocks, block, -1, 1), widths.shape[1], axis=3)
    low, high = (np.broadcast_to(sign * widths, shift.shape).copy() for sign in (-1.0, 1.0))
    for k in range(1, block):
        step = shift[:, k].copy()
        for limit in (low, high):
            limit[:, k] = np.clip(limit[:, k - 1] + step, -widths, widths)
        shift[:, k] += shift[:, k - 1]
    state, found = np.zeros(widths.shape), np.empty(shift.shape)
    for b in range(blocks):
        found[b] = np.minimum(np.maximum(state + shift[b], low[b]), high[b])
        state = found[b, -1]
    return found.reshape(-1, *widths.shape)[:count]
