"""Pairs of instants with equal position and opposite velocity (Eq. 15)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RecordingError
from lieid_casadi.friction_curves.one_way_motion import LEAST_SAMPLES, Pass, passes_of
from lieid_casadi.recording import Processed

SPEED_RATIO = 1.3  # largest ratio of the two speeds of a pair
OTHERS_APART = 0.03  # rad, largest difference of the other joints' positions in a pair
SPEED_STEP = 0.05  # relative step in which the speeds of two passes are compared


@dataclass(frozen=True, eq=False)
class Matching:
    """P pairs of instants at which a joint passes the same position forward and backward.

    Attributes
    ----------
    forward, backward : sparse (P, M)
        Matrices that interpolate the M concatenated filtered samples of all segments at the
        forward and at the backward instants.
    stretch : (P,) int
        Number of the pair of passes that each pair of instants comes from.
    samples : (P, 2) int
        Filtered samples nearest to the forward and to the backward instant.
    position : (P,)
        Position of the joint, rad.
    forward_speed, backward_speed : (P,)
        Absolute velocities, rad/s.
    """

    forward: csr_matrix[np.float64]
    backward: csr_matrix[np.float64]
    stretch: NDArray[np.intp]
    samples: NDArray[np.intp]
    position: Array
    forward_speed: Array
    backward_speed: Array

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
