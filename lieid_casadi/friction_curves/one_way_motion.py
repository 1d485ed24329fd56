"""Passes: stretches of motion in which one joint moves in one direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.recording import Processed

LEAST_SAMPLES = 4
ONE_DIRECTION = 0.99  # least filtered sign of velocity, which excludes samples near reversals


@dataclass(frozen=True, eq=False)
class Pass:
    """Filtered samples of one segment in which a joint moves in one direction.

    Attributes
    ----------
    segment : int
    samples : (S,) int
        Indices of the segment's filtered samples, in order of increasing ``position``.
    position : (S,)
        Position of the joint, increasing, rad.
    speed : (S,)
        Absolute velocity of the joint, rad/s.
    others : (S, n)
        Positions of all joints, rad.
    forward : bool
    time : float
        Mean time of the pass, s.
    """

    segment: int
    samples: NDArray[np.intp]
    position: Array
    speed: Array
    others: Array
    forward: bool
    time: float

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
