"""Effects that diagnoses find again and again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import betabinom

from lieid_casadi.fleet.statistics.changes import BASELINE_NIGHTS

#: Nights that the rate of the other arms counts as: rates of arms are alike, or differ freely.
RATE_WEIGHTS = (20.0, 1.0)


def repeated_finding(found: NDArray[np.bool_], rate: float) -> tuple[float, int]:
    """Return the p-value that an effect is found more often since a night, and that night.

    The rate of an arm has a beta distribution around that of the other arms, which the nights
    before update; the number of findings since then has a beta-binomial distribution. The larger
    p-value of a narrow and of a wide beta distribution is taken.

    Parameters
    ----------
    found : (N,) bool
        Whether a diagnosis found the effect, night by night.
    rate : float
        Part of the nights of the other arms on which it was found, above 0.

    Returns
    -------
    float
        Of the strongest beginning, corrected for the number of beginnings.
    int
        Position of the first night.
    """
    best, first = 1.0, len(found) - 1
    starts = [k for k in np.flatnonzero(found) if k >= BASELINE_NIGHTS]
    for k in starts:
        own, after = found[:k].sum(), found[k:]
        p = len(found) * max(
            float(
                betabinom.sf(
                    after.sum() - 1, len(after), own + w * rate, k - own + w * (1.0 - rate)
                )
            )
            for w in RATE_WEIGHTS
        )
        if p < best:
            best, first = p, int(k)
    return min(best, 1.0), first
