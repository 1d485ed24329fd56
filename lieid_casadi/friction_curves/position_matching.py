"""Instants of equal position and opposite velocity (Eq. 15)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from lieid_casadi.errors import RecordingError
from lieid_casadi.friction_curves.one_way_motion import LEAST_SAMPLES, Pass, passes_of
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
ALIKE = 1.3  # ratio of the two speeds up to which a pair is used
STILL = 0.03  # rad: how far the other joints may differ between the two instants


@dataclass(frozen=True, eq=False)
class Matching:
    """Pairs of instants at one position of a joint, once forward and once backward.

    Attributes
    ----------
    forward, backward : sparse (P, M)
        Each row takes a value at one instant from the filtered samples of all segments, one
        after the other.
    stretch : (P,) int
        Which two passes a pair comes from.
    position, forward_speed, backward_speed : (P,)
        rad, rad/s, positive.
    """

    forward: csr_matrix[np.float64]
    backward: csr_matrix[np.float64]
    stretch: NDArray[np.intp]
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

    Each pass goes with the opposite pass that covers the same positions at the most alike
    speed, the nearest in time among equals.

    Raises
    ------
    RecordingError
        The joint never moves, moves in one direction only, passes no position both ways, only
        at unlike speeds, or only with the other joints elsewhere.
    """
    passes = passes_of(segments, joint)
    _check_directions(passes, segments, joint, name)
    starts = np.cumsum([0, *(len(s.filtered_time) for s in segments)])
    couples = _couples(passes)
    if not couples:
        raise RecordingError(
            f"{name}: joint {joint + 1} passes no position both ways "
            f"(forward {_extent(passes, forward=True)}, backward "
            f"{_extent(passes, forward=False)} rad); record it over one range to and fro"
        )
    pairs = [_pairs(f, b, k, starts) for k, (f, b) in enumerate(couples)]
    joined = {key: np.concatenate([p[key] for p in pairs]) for key in pairs[0]}
    alike = np.abs(np.log(joined["forward_speed"] / joined["backward_speed"])) <= np.log(ALIKE)
    if not alike.any():
        raise RecordingError(
            f"{name}: joint {joint + 1} passes the same positions at unlike speeds only; "
            "record both ways at the same speeds"
        )
    still = joined["apart"] <= STILL
    if not (alike & still).any():
        raise RecordingError(
            f"{name}: when joint {joint + 1} comes back to a position, the other joints are "
            "elsewhere; record it while they stand still, or fit friction with identify"
        )
    kept = {key: values[alike & still] for key, values in joined.items()}
    return _matching(kept, int(starts[-1]))


def _check_directions(
    passes: Sequence[Pass], segments: Sequence[Processed], joint: int, name: str
) -> None:
    if not passes:
        fastest = max(float(np.abs(s.dq[:, joint]).max()) for s in segments)
        raise RecordingError(
            f"{name}: joint {joint + 1} never moves in one direction for long enough (fastest "
            f"{fastest:.2g} rad/s); record it moving to and fro"
        )
    if all(p.forward for p in passes) or not any(p.forward for p in passes):
        way, missing = ("forward", "backward") if passes[0].forward else ("backward", "forward")
        raise RecordingError(
            f"{name}: joint {joint + 1} moves {way} only; friction is half the difference of both "
            f"ways, record it {missing} over the same positions too"
        )


def _couples(passes: Sequence[Pass]) -> list[tuple[Pass, Pass]]:
    """Return which forward pass goes with which backward pass."""
    chosen: dict[tuple[int, int], tuple[Pass, Pass]] = {}
    for p in passes:
        rated = [
            (_unlikeness(p, other), k)
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


def _unlikeness(a: Pass, b: Pass) -> tuple[float, bool, float]:
    """Rate a pair of passes: ratio of speeds in steps of 5 %, then the time between them."""
    inside = (a.position >= b.low) & (a.position <= b.high)
    speed = np.interp(a.position[inside], b.position, b.speed)
    ratio = float(np.median(np.abs(np.log(a.speed[inside] / speed))))
    return round(ratio / 0.05), a.segment != b.segment, abs(a.time - b.time)


def _pairs(f: Pass, b: Pass, stretch: int, starts: NDArray[np.intp]) -> dict[str, Array]:
    """Return the pairs of two passes, at the samples of the forward one."""
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
    forward = _selection(pairs["forward"], np.ones(count), samples)
    backward = _selection(pairs["before"], 1.0 - share, samples)
    backward = backward + _selection(pairs["after"], share, samples)
    return Matching(
        forward,
        backward,
        pairs["stretch"].astype(np.intp),
        pairs["position"],
        pairs["forward_speed"],
        pairs["backward_speed"],
    )


def _selection(column: Array, weight: Array, width: int) -> csr_matrix[np.float64]:
    """Return a matrix (P, width) that takes one weighted value per row."""
    places = (np.arange(len(column)), column.astype(np.intp))
    return csr_matrix((weight, places), (len(column), width))


def _extent(passes: Sequence[Pass], *, forward: bool) -> str:
    own = [p for p in passes if p.forward == forward]
    return f"{min(p.low for p in own):.3g} to {max(p.high for p in own):.3g}"
