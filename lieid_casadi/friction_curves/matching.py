"""Pairs of instants with equal position and opposite velocity (Eq. 15), and averages of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags_array

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RecordingError
from lieid_casadi.recording import Processed

LEAST_SAMPLES = 4
ONE_DIRECTION = 0.99  # least filtered sign of velocity, which excludes samples near reversals


@dataclass(frozen=True, eq=False)
class Pass:
    """Filtered samples of one segment in which a joint moves in one direction."""

    segment: int
    #: (S,) int Indices of the segment's filtered samples, in order of increasing ``position``
    samples: NDArray[np.intp]
    position: Array  # (S,) Position of the joint, increasing, rad
    speed: Array  # (S,) Absolute velocity of the joint, rad/s
    others: Array  # (S, n) Positions of all joints, rad
    forward: bool
    time: float  # mean time of the pass, s

    @property
    def low(self) -> float:
        """Smallest position, rad."""
        return float(self.position[0])

    @property
    def high(self) -> float:
        """Largest position, rad."""
        return float(self.position[-1])


def passes_of(segments: Sequence[Processed], joint: int) -> list[Pass]:
    """Return the passes of a joint (from 0) in all segments."""
    return [p for k, segment in enumerate(segments) for p in _in_segment(segment, k, joint)]


def _in_segment(segment: Processed, number: int, joint: int) -> list[Pass]:
    direction = segment.filter(np.sign(segment.dq[:, joint]))
    steady = (np.abs(direction) > ONE_DIRECTION) & segment.filtered_moving[:, joint]
    side = np.where(steady, np.sign(direction), 0.0)
    edges = np.flatnonzero(np.diff(side)) + 1
    return [
        _pass(segment, number, joint, run, forward=bool(side[run[0]] > 0.0))
        for run in np.split(np.arange(len(side)), edges)
        if len(run) >= LEAST_SAMPLES and side[run[0]] != 0.0
    ]


def _pass(
    segment: Processed, number: int, joint: int, run: NDArray[np.intp], *, forward: bool
) -> Pass:
    times = segment.filtered_time[run]
    samples = run if forward else run[::-1]
    q, dq = segment.q[segment.kept][samples], segment.dq[segment.kept][samples]
    # noise can reverse the order of positions slightly at low speed
    position = np.maximum.accumulate(q[:, joint])
    return Pass(number, samples, position, np.abs(dq[:, joint]), q, forward, float(np.mean(times)))


SPEED_RATIO = 1.3  # largest ratio of the two speeds of a pair
OTHERS_APART = 0.03  # rad, largest difference of the other joints' positions in a pair
SPEED_STEP = 0.05  # relative step in which the speeds of two passes are compared


@dataclass(frozen=True, eq=False)
class Matching:
    """P pairs of instants at which a joint passes the same position forward and backward."""

    #: matrices that interpolate the M concatenated filtered samples of all segments at the forward
    #: and at the backward instants
    forward: csr_matrix[np.float64]
    #: matrices that interpolate the M concatenated filtered samples of all segments at the forward
    #: and at the backward instants
    backward: csr_matrix[np.float64]
    #: (P,) int Number of the pair of passes that each pair of instants comes from
    stretch: NDArray[np.intp]
    #: (P, 2) int Filtered samples nearest to the forward and to the backward instant
    samples: NDArray[np.intp]
    position: Array  # (P,) Position of the joint, rad
    forward_speed: Array  # (P,) Absolute velocities, rad/s
    backward_speed: Array  # (P,) Absolute velocities, rad/s

    @property
    def speed(self) -> Array:
        """Mean of the two speeds (P,), rad/s."""
        return 0.5 * (self.forward_speed + self.backward_speed)

    def half_difference(self, samples: Array) -> Array:
        """Return half of forward − backward (P, …) of filtered samples (M, …)."""
        return np.asarray(0.5 * (self.forward @ samples - self.backward @ samples))

    def half_sum(self, samples: Array) -> Array:
        """Return the mean of forward and backward (P, …) of filtered samples (M, …)."""
        return np.asarray(0.5 * (self.forward @ samples + self.backward @ samples))


def match(segments: Sequence[Processed], joint: int, *, name: str = "recording") -> Matching:
    """Match the forward and backward motion of a joint (from 0) by position.

    Each pass is matched with the pass in the opposite direction that covers the same positions
    at the most similar speed, and among equals with the nearest in time.

    ``joint``: from 0; ``name``: name of the recordings in messages.
    Raises `RecordingError`: the joint never moves or moves in one direction only; no position is
    passed in both directions; or only at different speeds, or with the other joints at other
    positions.
    """
    passes = passes_of(segments, joint)
    _check_directions(passes, segments, joint, name)
    starts = np.cumsum([0, *(len(s.filtered_time) for s in segments)])
    matched = _matched_passes(passes)
    if not matched:
        raise RecordingError(
            f"{name}: joint {joint + 1} passes no position in both directions "
            f"(forward {_extent(passes, forward=True)}, backward "
            f"{_extent(passes, forward=False)} rad); record it forward and backward "
            "over the same range"
        )
    pairs = [_pairs(f, b, k, starts) for k, (f, b) in enumerate(matched)]
    joined = {key: np.concatenate([p[key] for p in pairs]) for key in pairs[0]}
    similar = np.abs(np.log(joined["forward_speed"] / joined["backward_speed"])) <= np.log(
        SPEED_RATIO
    )
    if not similar.any():
        raise RecordingError(
            f"{name}: joint {joint + 1} passes the same positions only at different "
            "speeds; record both directions at the same speeds"
        )
    still = joined["apart"] <= OTHERS_APART
    if not (similar & still).any():
        raise RecordingError(
            f"{name}: when joint {joint + 1} returns to a position, the other joints have moved; "
            "record it while they stand still, or fit friction with identify"
        )
    kept = {key: values[similar & still] for key, values in joined.items()}
    return _matching(kept, int(starts[-1]))


def _check_directions(
    passes: Sequence[Pass], segments: Sequence[Processed], joint: int, name: str
) -> None:
    if not passes:
        fastest = max(float(np.abs(s.dq[:, joint]).max()) for s in segments)
        raise RecordingError(
            f"{name}: joint {joint + 1} never moves in one direction for long enough (fastest "
            f"{fastest:.2g} rad/s); record it moving forward and backward"
        )
    if all(p.forward for p in passes) or not any(p.forward for p in passes):
        found, missing = ("forward", "backward") if passes[0].forward else ("backward", "forward")
        raise RecordingError(
            f"{name}: joint {joint + 1} moves {found} only; friction is half the difference of "
            f"both directions, so record it {missing} over the same positions as well"
        )


def _matched_passes(passes: Sequence[Pass]) -> list[tuple[Pass, Pass]]:
    """Return pairs of a forward and a backward pass."""
    chosen: dict[tuple[int, int], tuple[Pass, Pass]] = {}
    for p in passes:
        rated = [
            (_difference(p, other), k)
            for k, other in enumerate(passes)
            if other.forward != p.forward and _overlap(p, other)
        ]
        if rated:
            other = passes[min(rated)[1]]
            f, b = (p, other) if p.forward else (other, p)
            chosen[id(f), id(b)] = f, b
    return list(chosen.values())


def _overlap(a: Pass, b: Pass) -> bool:
    low, high = max(a.low, b.low), min(a.high, b.high)
    inside = (a.position >= low) & (a.position <= high)
    return high > low and int(inside.sum()) >= LEAST_SAMPLES


def _difference(a: Pass, b: Pass) -> tuple[float, bool, float]:
    """Return a sort key of two passes: speed ratio in steps, another segment, time between."""
    inside = (a.position >= b.low) & (a.position <= b.high)
    speed = np.interp(a.position[inside], b.position, b.speed)
    ratio = float(np.median(np.abs(np.log(a.speed[inside] / speed))))
    return round(ratio / SPEED_STEP), a.segment != b.segment, abs(a.time - b.time)


def _pairs(f: Pass, b: Pass, stretch: int, starts: NDArray[np.intp]) -> dict[str, Array]:
    """Return pairs of instants of two passes, one for each sample of the forward pass."""
    inside = (f.position >= b.low) & (f.position <= b.high)
    position = f.position[inside]
    place = np.interp(position, b.position, np.arange(len(b.position)))
    before = np.minimum(place.astype(np.intp), len(b.position) - 2)
    share = place - before
    others = b.others[before] + share[:, None] * (b.others[before + 1] - b.others[before])
    return {
        "position": position,
        "forward": f.samples[inside] + starts[f.segment],
        "before": b.samples[before] + starts[b.segment],
        "after": b.samples[before + 1] + starts[b.segment],
        "share": share,
        "forward_speed": f.speed[inside],
        "backward_speed": np.interp(position, b.position, b.speed),
        "apart": np.abs(f.others[inside] - others).max(axis=1),
        "stretch": np.full(len(position), stretch),
    }


def _matching(pairs: dict[str, Array], samples: int) -> Matching:
    count = len(pairs["position"])
    share = pairs["share"]
    nearest = np.where(share < 0.5, pairs["before"], pairs["after"])
    forward = _selection(pairs["forward"], np.ones(count), samples)
    backward = _selection(pairs["before"], 1.0 - share, samples)
    backward = backward + _selection(pairs["after"], share, samples)
    return Matching(
        forward,
        backward,
        pairs["stretch"].astype(np.intp),
        np.column_stack([pairs["forward"], nearest]).astype(np.intp),
        pairs["position"],
        pairs["forward_speed"],
        pairs["backward_speed"],
    )


def _selection(column: Array, weight: Array, width: int) -> csr_matrix[np.float64]:
    """Return a matrix (P, width) with one weight per row."""
    places = (np.arange(len(column)), column.astype(np.intp))
    return csr_matrix((weight, places), (len(column), width))


def _extent(passes: Sequence[Pass], *, forward: bool) -> str:
    own = [p for p in passes if p.forward == forward]
    return f"{min(p.low for p in own):.3g} to {max(p.high for p in own):.3g}"


MOST_SPEEDS = 40
FINEST = 0.06  # least relative width of a speed group
LOADS = 6
LOAD_RANGE = 0.2  # range of loads, relative to the largest, below which they form one group
LEAST_PAIRS = 3
BATCH = 8  # pairs: two periods of the cut-off, beyond which filtered noise is uncorrelated
PRIOR_WEIGHT = 4.0  # number of batches that the common scatter of all groups counts for


@dataclass(frozen=True, eq=False)
class PairGroups:
    """Assignment of P pairs of instants to G groups."""

    average: csr_matrix[np.float64]  # matrix that averages values of pairs over each group
    member: NDArray[np.intp]  # (P,) int Group of each pair, −1 for none
    count: NDArray[np.intp]  # (G,) int Number of stretches of motion that each group has pairs from

    def mean(self, values: Array) -> Array:
        """Return each group's average (G, …) of values (P, …)."""
        return np.asarray(self.average @ values)


def group_pairs(speed: Array, load: Array, stretch: NDArray[np.intp]) -> PairGroups:
    """Group pairs by speed (logarithmically) and, if it varies, by the magnitude of the load."""
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
