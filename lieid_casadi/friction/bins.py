"""Groups of pairs of about one speed and one load, and what they average to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags_array

Array = NDArray[np.float64]
MOST_SPEEDS = 40
FINEST = 0.06  # relative width of a speed group, at least
LOADS = 6
LOAD_SPREAD = 0.2  # of the largest load: a smaller spread is one group
LEAST_PAIRS = 3
PRIOR_WEIGHT = 4.0  # stretches' worth of trust in the scatter of all groups together


@dataclass(frozen=True, eq=False)
class Groups:
    """Averages over groups of pairs.

    ``average`` (G, P) is sparse; ``member`` (P,) names each pair's group, −1 for none; ``count``
    (G,) is how many stretches of motion a group has pairs from.
    """

    average: csr_matrix[np.float64]
    member: NDArray[np.intp]
    count: NDArray[np.intp]

    def mean(self, values: Array) -> Array:
        """Return each group's average (G, …) of values (P, …)."""
        return np.asarray(self.average @ values)


def group(speed: Array, load: Array, stretch: NDArray[np.intp]) -> Groups:
    """Group pairs by speed (logarithmically) and, where it varies, by the size of the load.

    Parameters
    ----------
    speed, load : (P,)
        rad/s, N·m.
    stretch : (P,) int
    """
    cell = _by_speed(speed) * LOADS + _by_load(np.abs(load))
    _, member, pairs = np.unique(cell, return_inverse=True, return_counts=True)
    kept = np.flatnonzero(pairs >= min(LEAST_PAIRS, pairs.max()))
    number = np.full(len(pairs), -1)
    number[kept] = np.arange(len(kept))
    member = number[member]
    inside = np.flatnonzero(member >= 0)
    ones = csr_matrix((np.ones(len(inside)), (member[inside], inside)), (len(kept), len(speed)))
    average = csr_matrix(diags_array(1.0 / pairs[kept]) @ ones)
    count = np.array([len(np.unique(stretch[member == g])) for g in range(len(kept))])
    return Groups(average, member.astype(np.intp), count.astype(np.intp))


def standard_errors(groups: Groups, values: Array, stretch: NDArray[np.intp]) -> Array:
    """Return the standard error (G,) of each group's average of values (P,).

    Neighbouring pairs are not independent, but stretches of motion are: the scatter is that of
    their means, drawn towards the scatter common to all groups where a group has few. Without
    any group of two stretches it is that of the pairs, as if every fourth were independent.
    """
    means = groups.mean(values)
    squares, freedom = np.zeros(len(means)), np.zeros(len(means))
    for g in range(len(means)):
        inside = groups.member == g
        own = np.unique(stretch[inside])
        per_stretch = np.array([values[inside & (stretch == s)].mean() for s in own])
        squares[g] = np.sum((per_stretch - per_stretch.mean()) ** 2)
        freedom[g] = len(own) - 1
    if freedom.sum() == 0:
        return _errors_of_pairs(groups, values, means)
    common = squares.sum() / freedom.sum()
    variance = (PRIOR_WEIGHT * common + squares) / (PRIOR_WEIGHT + freedom)
    return np.asarray(np.sqrt(variance / groups.count))


def _errors_of_pairs(groups: Groups, values: Array, means: Array) -> Array:
    inside = groups.member >= 0
    scatter = values[inside] - means[groups.member[inside]]
    pairs = np.bincount(groups.member[inside], minlength=len(means))
    return np.asarray(np.sqrt(np.mean(scatter**2) / np.maximum(pairs / 4.0, 1.0)))


def _by_speed(speed: Array) -> NDArray[np.intp]:
    logarithm = np.log(speed)
    low, high = logarithm.min(), logarithm.max()
    width = max(FINEST, (high - low) / MOST_SPEEDS)
    return np.asarray((logarithm - low) / width, dtype=np.intp)


def _by_load(size: Array) -> NDArray[np.intp]:
    low, high = size.min(), size.max()
    if high <= 0.0 or (high - low) < LOAD_SPREAD * high:
        return np.zeros(len(size), dtype=np.intp)
    place = (size - low) / (high - low) * LOADS
    return np.asarray(np.minimum(place, LOADS - 1), dtype=np.intp)
