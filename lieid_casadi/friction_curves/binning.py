"""Groups of pairs of instants with similar speed and load, and their averages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags_array

from lieid_casadi.arrays import Array

MOST_SPEEDS = 40
FINEST = 0.06  # least relative width of a speed group
LOADS = 6
LOAD_RANGE = 0.2  # range of loads, relative to the largest, below which they form one group
LEAST_PAIRS = 3
BATCH = 8  # pairs: two periods of the cut-off, beyond which filtered noise is uncorrelated
PRIOR_WEIGHT = 4.0  # number of batches that the common scatter of all groups counts for


@dataclass(frozen=True, eq=False)
class PairGroups:
    """Assignment of P pairs of instants to G groups.

    Attributes
    ----------
    average : sparse (G, P)
        Matrix that averages values of pairs over each group.
    member : (P,) int
        Group of each pair, −1 for none.
    count : (G,) int
        Number of stretches of motion that each group has pairs from.
    """

    average: csr_matrix[np.float64]
    member: NDArray[np.intp]
    count: NDArray[np.intp]

    def mean(self, values: Array) -> Array:
        """Return each group's average (G, …) of values (P, …)."""
        return np.asarray(self.average @ values)


def group_pairs(speed: Array, load: Array, stretch: NDArray[np.intp]) -> PairGroups:
    """Group pairs by speed (logarithmically) and, if it varies, by the magnitude of the load.

    ``speed``, ``load`` (P,): speed (positive) and load of each pair, rad/s and N·m; ``stretch``
    (P,): stretch of motion that each pair comes from.
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
    return PairGroups(average, member.astype(np.intp), count.astype(np.intp))


def standard_errors(
    groups: PairGroups,
    values: Array,
    stretch: NDArray[np.intp],
    samples: NDArray[np.intp],
    trends: Array,
) -> Array:
    """Return the standard error (G,) of the average of each group.

    Neighbouring pairs are correlated, batches of them are not. The variance is estimated from the
    means of batches and shrunk towards the variance common to all groups, which dominates in
    groups with few batches. Samples that occur in several pairs count once.

    ``values`` (P,): value of each pair; ``stretch`` (P,): stretch of motion that each pair comes
    from; ``samples`` (P, 2): the two samples of each pair; ``trends`` (P, k): quantities whose
    linear influence within the groups is not counted as scatter.
    """
    inside = np.flatnonzero(groups.member >= 0)
    member = groups.member[inside]
    scatter = _off_mean(np.column_stack([values, trends])[inside], member)
    slope = np.linalg.lstsq(scatter[:, 1:], scatter[:, 0], rcond=None)[0]
    residual = scatter[:, 0] - scatter[:, 1:] @ slope
    batch, owner = _batches(member, stretch[inside])
    size = np.bincount(batch)
    means = np.bincount(batch, residual) / size
    # var(batch mean) = variance/size, so that batches are weighted by their size
    squares = np.bincount(owner, size * means**2)
    count = np.bincount(owner)
    freedom = np.maximum(count - 1.0, 0.0)
    pairs = np.bincount(member) / _reuse(member, samples[inside])
    if freedom.sum() == 0.0:
        return np.asarray(np.sqrt(np.mean(residual**2) / np.maximum(pairs / BATCH, 1.0)))
    common = squares[freedom > 0].sum() / freedom.sum()
    variance = (PRIOR_WEIGHT * common + squares) / (PRIOR_WEIGHT + freedom)
    return np.asarray(np.sqrt(variance / pairs))


def _reuse(member: NDArray[np.intp], samples: NDArray[np.intp]) -> Array:
    """Return the factor (G,) on the variance of averages due to samples in several pairs.

    A sample with weight w contributes w² to the variance: with c occurrences in a group, the
    factor is Σ c² / Σ c over its samples.
    """
    width = int(samples.max()) + 1
    keys, count = np.unique(member[:, None] * width + samples, return_counts=True)
    group = keys // width
    return np.asarray(np.bincount(group, count**2) / np.bincount(group, count))


def _off_mean(values: Array, member: NDArray[np.intp]) -> Array:
    """Return values (P, k) minus the mean of their group."""
    pairs = np.bincount(member)
    means = [np.bincount(member, column) / pairs for column in values.T]
    return values - np.array(means).T[member]


def _batches(
    member: NDArray[np.intp], stretch: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the batch of each pair, and the group of each batch.

    A batch has consecutive pairs of one group and one stretch.
    """
    change = (np.diff(member) != 0) | (np.diff(stretch) != 0)
    run = np.concatenate([[0], np.cumsum(change)])
    first = np.concatenate([[0], np.flatnonzero(change) + 1])
    within = (np.arange(len(member)) - first[run]) // BATCH
    _, index, batch = np.unique(
        np.column_stack([run, within]), axis=0, return_index=True, return_inverse=True
    )
    return np.ravel(batch).astype(np.intp), member[index]


def _by_speed(speed: Array) -> NDArray[np.intp]:
    logarithm = np.log(speed)
    low, high = logarithm.min(), logarithm.max()
    width = max(FINEST, (high - low) / MOST_SPEEDS)
    return np.asarray((logarithm - low) / width, dtype=np.intp)


def _by_load(size: Array) -> NDArray[np.intp]:
    low, high = size.min(), size.max()
    if high <= 0.0 or (high - low) < LOAD_RANGE * high:
        return np.zeros(len(size), dtype=np.intp)
    place = (size - low) / (high - low) * LOADS
    return np.asarray(np.minimum(place, LOADS - 1), dtype=np.intp)
