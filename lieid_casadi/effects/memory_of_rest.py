"""Where the torque of a joint is known, and the torque before it on which it depends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def where_known(change: Array, t: Array, known: NDArray[np.bool_], past: float) -> Array:
    """Return a change of torque (K, n), zero where it depends on unknown friction.

    At rest friction has any value up to its level, and the instants at which a joint starts and
    stops have an error of up to one sample. A delayed or filtered torque depends on them for as
    long as its memory reaches: a step of friction there, wrong by one sample, would exceed all
    that the delay of the smooth motion causes.

    Parameters
    ----------
    change : (K, n)
        N·m, or N·m per unit of a coefficient.
    t : (K,)
        s.
    known : (K, n) bool
        Whether the friction of each joint is known.
    past : float
        Length of the memory, s; negative for a torque that depends on the time to come.
    """
    step = (t[-1] - t[0]) / max(len(t) - 1, 1)
    first, last = t - max(past, 0.0) - step, t + max(-past, 0.0) + step
    result = change.copy()
    for j, own in enumerate(known.T):
        unknown = np.append(t[~own], np.inf)
        result[unknown[np.searchsorted(unknown, first)] <= last, j] = 0.0
    return result
