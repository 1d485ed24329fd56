"""Whether the error of a stretch returns on other passes through the same motion or position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from lieid_casadi.diagnosis.events.residual_signals import ResidualSignals
from lieid_casadi.diagnosis.options import DiagnosisOptions

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Stretch:
    """Rows ``first`` to ``last`` − 1 with an outstanding error."""

    first: int
    last: int


def returns_with_state(
    own: ResidualSignals, stretch: Stretch, joint: int, inside: Mask, options: DiagnosisOptions
) -> bool:
    """Return whether an error returns with the motion, or cannot be compared with other times.

    Parameters
    ----------
    own : ResidualSignals
    stretch : Stretch
    joint : int
        From 0.
    inside : (M,) bool
        Rows of all stretches, which are not compared.
    options : DiagnosisOptions
    """
    same = _Same(own.state[:, joint], options.event_state, ~inside, own.transient[:, joint])
    visits = _visits(own, stretch, joint, same, options)
    if visits.count < options.least_event_visits:
        return True
    return visits.similar > options.most_similar_visits * visits.count


def returns_with_position(
    own: ResidualSignals, stretch: Stretch, joint: int, options: DiagnosisOptions
) -> bool:
    """Return whether an error returns on most passes through its positions, as at a rough spot.

    It has the same sign on all of them, or that of the velocity. A push of a joint that is held
    is none: the joint stays at one position.

    Parameters
    ----------
    own : ResidualSignals
    stretch : Stretch
    joint : int
        From 0.
    options : DiagnosisOptions
    """
    if own.still[stretch.first : stretch.last, joint].any():
        return False
    place, error, every = own.place[:, joint], own.transient[:, joint], np.full(len(own.time), True)
    for signed in (error, error * own.direction[:, joint]):
        same = _Same(place[:, None], options.event_place, every, signed)
        visits = _visits(own, stretch, joint, same, options)
        if visits.count >= options.least_event_visits and 2 * visits.similar > visits.count:
            return True
    return False


@dataclass(frozen=True)
class _Same:
    """What passes have in common: signals within a width, and the sign of another one.

    Attributes
    ----------
    signals : (M, s)
    width : float
    allowed : (M,) bool
        Rows that are compared.
    signed : (M,)
    """

    signals: Array
    width: float
    allowed: Mask
    signed: Array


@dataclass(frozen=True)
class _Visits:
    """Other passes of a joint through the state at the peak of an error."""

    count: int
    similar: int


def _visits(
    own: ResidualSignals, stretch: Stretch, joint: int, same: _Same, options: DiagnosisOptions
) -> _Visits:
    """Count the other passes through what a stretch has, and those with a similar error."""
    rows = slice(stretch.first, stretch.last)
    peak = own.excess[rows, joint].max()
    at = stretch.first + int(np.argmax(own.excess[rows, joint]))
    large = stretch.first + np.flatnonzero(own.excess[rows, joint] > 0.5 * peak)
    tree = KDTree(same.signals[large])
    near = tree.query(same.signals, p=np.inf)[0] < same.width
    time = own.time
    near &= same.allowed & (
        (time < time[stretch.first] - options.event_gap)
        | (time > time[stretch.last - 1] + options.event_gap)
    )
    similar = np.sign(same.signed) == np.sign(same.signed[at])
    similar &= own.excess[:, joint] > options.similar_event * peak
    where = np.flatnonzero(near)
    if not len(where):
        return _Visits(0, 0)
    visit = np.cumsum(np.diff(own.time[where], prepend=own.time[where[0]]) > options.event_gap)
    # A held joint makes one long visit: each second of it counts.
    visit = visit + np.floor(own.time[where]).astype(int) * (visit.max() + 1)
    _, number = np.unique(visit, return_inverse=True)
    returned = np.bincount(number, weights=similar[where]) > 0
    return _Visits(len(returned), int(returned.sum()))
