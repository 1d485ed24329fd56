"""Joints whose error stays far above what a complete model would have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import Unexplained

Array = NDArray[np.float64]


def errors_above(
    error: Array, reachable: Array, most: float, parts: Sequence[Unexplained]
) -> tuple[Unexplained, ...]:
    """Return an unexplained part for every joint with a large error and no other part.

    No smooth function of the signals explains it, so that it depends on no signal.

    Parameters
    ----------
    error : (n,)
        Of each joint, N·m.
    reachable : (n,)
        Error of a complete model, N·m; NaN where it is not known.
    most : float
        Ratio of the two above which the error counts as large.
    parts : sequence of Unexplained
        Parts that depend on signals.
    """
    known = np.isfinite(reachable) & (reachable > 0.0)
    ratio = np.where(known, error / np.where(known, reachable, 1.0), 0.0)
    explained = {part.joint for part in parts}
    return tuple(
        Unexplained(int(j), float(1.0 - ratio[j] ** -2), (), ratio=float(ratio[j]))
        for j in np.argsort(-ratio)
        if ratio[j] > most and j not in explained
    )
