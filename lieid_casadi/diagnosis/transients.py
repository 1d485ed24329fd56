"""Transient errors: contact, collisions and faults of the recorder, not properties of the arm.

An error is transient if it is far beyond the spread of the errors around it, if functions of the
joint's own motion do not explain it, and if the joint passes through the same velocity,
acceleration and load at other times without it, and through the same position, too. A property of
the arm returns with the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d
from scipy.spatial import KDTree

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.comparison.compare import compared_segments
from lieid_casadi.effects.torque_delay import delayed_change
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.identification.uncertainty.noise_model import (
    common_effect_columns,
    dry_level,
    friction_torque_std,
)
from lieid_casadi.messages import joints_text
from lieid_casadi.recording import Processed, Recording

#: Robust standard deviations of a joint's error, beyond friction at rest, from which an error may
#: be transient, and those at the ends of the stretch; ends are also relative to the peak.
LEAST, LEAST_END, END_PART = 12.0, 4.0, 0.1
RATIO = 2.0  # of the smallest transient error to the largest other error of a joint
GAP = 0.5  # s between two events, and between two passes through the same state
SAME_STATE = 0.2  # of the largest velocity, acceleration, load: two states are the same
SAME_PLACE = 0.02  # of the range of positions: two positions are the same
LEAST_VISITS = 2  # passes through the same state at other times, for comparison
SIMILAR = 0.3  # of the error at the peak: from here another error is similar
MOST_SIMILAR = 0.2  # of these passes: with more similar errors, it is a property of the arm
LAG = 4  # samples, one period of the cut-off: independent noise
LEAST_SCALE = 1e-3  # of the RMS of a joint's torque
FEWEST_FROZEN = 10  # rows with one and the same torque on every joint
SPIKE_ROWS = 3  # rows: a shorter error is a fault of the recorder
DEVIATIONS = 2.5  # of a uniform distribution over the level of dry friction: beyond its ends
STILL_TIME, STILL_RANGE = 1.0, 0.02  # s, rad: a joint that stays in this range may be held
SLOW = 0.05  # of the top speed: near a reversal friction may have either sign
STICTION = 1.5  # of the level of dry friction at low speed: friction at rest may exceed it
RESTING = 4.0  # s: an arm that rests for longer is compared with its median torque
HELD = 1.5  # of the level of dry friction: change of the friction of an arm that rests
BISQUARE = 4.685  # tuning constant of Tukey's bisquare: 95 % efficiency for Gaussian errors
LATEST = 0.1  # s: the longest delay of a torque signal that a diagnosis names
ROUNDS = 12  # of the reweighted regression
FEWEST_MOVING = 50  # samples in motion for a scale of their own
Kind = Literal["contact", "fault", "standstill"]


@dataclass(frozen=True)
class Event:
    """A stretch of a recording that is left out of a diagnosis.

    Attributes
    ----------
    kind : str
        ``contact``: a transient torque that the motion does not explain. ``fault``: samples that
        the recorder lost or repeated. ``standstill``: joints that do not move enough.
    recording : Source
    start, end : float
        On the recording's clock, s.
    joints : tuple of int
        From 0.
    peak : float
        Largest error of these joints, N·m.
    sentence : str
        What was found, where, and with which consequence.
    """

    kind: Kind
    recording: Source
    start: float
    end: float
    joints: tuple[int, ...]
    peak: float
    sentence: str

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, with joints from 1."""
        return {
            "kind": self.kind,
            "recording": self.recording.name,
            "from": self.start,
            "to": self.end,
            "joints": [joint + 1 for joint in self.joints],
            "peak": self.peak,
            "sentence": self.sentence,
        }


def transient_events(fit: Fit, recordings: Sequence[Recording]) -> tuple[Event, ...]:
    """Return the transient errors of a fit along recordings with torques, in the order of time."""
    signals, scale = _signals(fit, recordings)
    found: list[Event] = []
    for own in signals:
        size = own.excess / scale
        errors = [e for j in range(fit.model.n) for e in outstanding(own, size, j)]
        found += [_event(own, scale, event) for event in _together(errors, own.time)]
    return tuple(found)


def unexplained_events(
    fit: Fit, recordings: Sequence[Recording], events: Sequence[Event]
) -> tuple[Event, ...]:
    """Return the events in which a fit has transient errors, too, and joints at rest."""
    signals, scale = _signals(fit, recordings)

    def large(event: Event, own: ResidualSignals) -> bool:
        inside = (own.time >= event.start) & (own.time <= event.end)
        same = event.recording.sha256 == own.segment.recording.source_hash
        return same and bool((own.excess[inside] > LEAST * scale).any())

    return tuple(e for e in events if e.kind == "standstill" or any(large(e, s) for s in signals))


def _signals(fit: Fit, recordings: Sequence[Recording]) -> tuple[list[ResidualSignals], Array]:
    """Return the errors of a fit along recordings, and the scale of each joint's (n,), N·m."""
    signals = [ResidualSignals.of(fit, s) for s in compared_segments(fit, recordings)]
    return signals, _scale(signals)


def _scale(signals: Sequence[ResidualSignals]) -> Array:
    """Return the robust standard deviation of each joint's error (n,), N·m.

    Of a joint that hardly moves it is that of differences in time, which changes of its friction
    at rest do not enlarge. It is at least a small part of the joint's torque: in recordings
    without noise, errors of differentiation are no events.
    """
    torque = np.concatenate(
        [s.segment.filter(s.segment.tau) for s in signals if s.segment.tau is not None]
    )
    least = LEAST_SCALE * np.sqrt(np.mean(torque**2, axis=0))
    transient = np.concatenate([s.transient for s in signals])
    still = np.concatenate([s.still for s in signals])
    found = []
    for own, held in zip(transient.T, still.T, strict=True):
        moving = own[~held]
        enough = len(moving) >= FEWEST_MOVING
        found.append(robust_scale(moving if enough else (own[LAG:] - own[:-LAG]) / np.sqrt(2.0)))
    return np.asarray(np.maximum(found, np.maximum(least, 1e-9)))


def outstanding(own: ResidualSignals, size: Array, joint: int) -> list[slice]:
    """Return the errors of a joint that are far above all others and not due to its motion."""
    peaks = _peaks(own.time, size[:, joint])
    sizes = np.array([size[k, joint] for k in peaks])
    ratios = sizes[:-1] / np.maximum(sizes[1:], 1.0)
    usable = np.flatnonzero((sizes[:-1] > LEAST) & (ratios > RATIO))
    if not len(usable):
        return []
    peaks = peaks[: int(usable[-1]) + 1]
    return [
        stretch
        for stretch in (_around(size[:, joint], k) for k in peaks)
        if _fault(own, stretch, [joint])
        or not (
            returns_with_state(own, stretch, joint) or returns_with_position(own, stretch, joint)
        )
    ]


def _peaks(time: Array, size: Array) -> list[int]:
    """Return the rows of the largest values that are apart from each other, largest first."""
    allowed = np.ones(len(size), dtype=bool)
    found: list[int] = []
    while allowed.any():
        k = int(np.argmax(np.where(allowed, size, -1.0)))
        found.append(k)
        if size[k] < LEAST:
            break
        allowed &= _apart(time, _around(size, k))
    return found


def _around(size: Array, peak: int) -> slice:
    """Return the rows around a peak until the error is small."""
    low = size < max(LEAST_END, END_PART * size[peak])
    before, after = np.flatnonzero(low[:peak]), np.flatnonzero(low[peak:])
    first = int(before[-1]) + 1 if len(before) else 0
    return slice(first, peak + int(after[0]) if len(after) else len(size))


def _together(errors: Sequence[slice], time: Array) -> list[slice]:
    """Return the stretches in the order of time, those that overlap or nearly so joined."""
    joined: list[slice] = []
    for error in sorted(errors, key=lambda e: e.start):
        if joined and time[error.start] - time[joined[-1].stop - 1] < GAP:
            error = slice(joined[-1].start, max(joined.pop().stop, error.stop))
        joined.append(error)
    return joined


def _apart(time: Array, stretch: slice) -> Mask:
    """Return the rows (M,) that are long before or after a stretch."""
    return np.asarray(np.maximum(time[stretch.start] - time, time - time[stretch.stop - 1]) > GAP)


def _event(own: ResidualSignals, scale: Array, stretch: slice) -> Event:
    large = (own.excess / scale)[stretch].max(axis=0) > LEAST
    joints = tuple(map(int, np.flatnonzero(large)))
    start, end = float(own.time[stretch.start]), float(own.time[stretch.stop - 1])
    peak = float(np.abs(own.transient[stretch][:, joints]).max())
    segment, fault = own.segment, _fault(own, stretch, joints)
    kind: Kind = "fault" if fault else "contact"
    name = segment.recording.name or "recording"
    where = joints_text(j in joints for j in range(len(scale)))
    sentence = (
        f"{name}, {start:.1f}–{end:.1f} s: error of up to {peak:.3g} N·m on {where} "
        f"that the motion does not explain: {fault or 'contact or a collision'}; this stretch is "
        "left out."
    )
    source = Source(name, segment.recording.source_hash)
    return Event(kind, source, start, end, joints, peak, sentence)


def _fault(own: ResidualSignals, stretch: slice, joints: Sequence[int]) -> str:
    """Return what shows a fault of the recorder in an error of joints, or an empty text."""
    segment, raw = own.segment, own.segment.recording
    peak = np.abs(own.transient[stretch][:, joints]).max(axis=0)
    assert raw.tau is not None
    start, end = own.time[stretch.start], own.time[stretch.stop - 1]
    margin = 0.5 / segment.cutoff
    rows = np.flatnonzero((raw.t >= start - margin) & (raw.t <= end + margin))
    same = np.all(np.diff(raw.tau[rows], axis=0) == 0.0, axis=1)
    run = np.diff(np.flatnonzero(np.concatenate([[True], ~same, [True]]))).max()
    if run >= FEWEST_FROZEN:
        return f"{run} samples have the same torque on every joint, a fault of the recorder"
    # a median keeps the step of friction at a reversal; a filtered spike is less than a raw one
    own_tau = raw.tau[:, joints]
    away = np.abs(own_tau - median_filter(own_tau, (2 * SPIKE_ROWS + 1, 1)))[rows]
    least = np.maximum(10.0 * np.median(away, axis=0), peak)
    far = np.any(away > np.maximum(0.5 * away.max(axis=0), least), axis=1)
    if 0 < far.sum() <= SPIKE_ROWS:
        return f"single samples ({far.sum()}) far from their neighbours, a fault of the recorder"
    return ""


@dataclass(frozen=True, eq=False)
class ResidualSignals:
    """Error of a fit along one segment at M instants."""

    segment: Processed
    #: (M,): s, on the recording's clock
    time: Array
    #: (M, n): measured − predicted torque, N·m
    error: Array
    #: (M, n): error without what functions of the joint's own motion explain, N·m
    transient: Array
    #: (M, n): torque that dry friction may add or not, N·m
    slack: Array
    #: (M, n): whether a joint stays in a small range
    still: Mask
    #: (M, n, 3): velocity, acceleration and load of each joint relative to their largest values
    state: Array
    #: (M, n) each: position of each joint relative to its range, and sign of its velocity
    place: Array
    direction: Array

    @classmethod
    def of(cls, fit: Fit, segment: Processed) -> ResidualSignals:
        """Return the signals of a segment with torque, temperatures relative to the fit's."""
        assert segment.tau is not None
        compiled, links = fit.compiled, fit.link_parameters
        torque = torque_along(compiled, segment, fit.parameters, fit.shapes)
        error = segment.filter(segment.tau - torque)
        motion = segment.q, segment.dq, segment.ddq
        q, dq, ddq = (segment.filter(x) for x in motion)
        load = segment.filter(compiled.inverse_dynamics(*motion, links))
        still, top = _still(q, segment), np.maximum(np.abs(dq).max(axis=0), 1e-9)
        uncertain = friction_torque_std(compiled, segment, fit.shapes, fit.parameters)
        level = segment.filter(dry_level(compiled, segment, fit.shapes, fit.parameters))
        # The sign of a joint that is held is unknown: the prediction errs by up to both levels.
        slack = np.maximum(
            DEVIATIONS * uncertain, np.where(np.abs(dq) < SLOW * top, 2.0, 0.0) * level
        )
        slack[still] = 2.0 * STICTION * level[still]
        rests = _rests(still, segment)
        for rest in rests:
            slack[rest] = HELD * level[rest]
        common = common_effect_columns(compiled, segment, links)
        own = np.stack([np.ones_like(q), np.tanh(10.0 * dq / top), dq / top, load, q], axis=-1)
        columns = np.concatenate([common, own, _late_torque(segment, torque)], axis=-1)
        transient = np.column_stack(
            [_without_columns(error[:, j], columns[:, j], ~still[:, j]) for j in range(fit.model.n)]
        )
        if rests:
            held = replace(segment, dq=np.zeros_like(segment.q), ddq=np.zeros_like(segment.q))
            static = torque_along(compiled, held, fit.parameters, fit.shapes)
            at_rest = segment.filter(segment.tau - static)
            for rest in rests:
                transient[rest] = at_rest[rest] - np.median(at_rest[rest], axis=0)
        motions = np.where(still, 0.0, dq), np.where(still, 0.0, ddq), load
        relative = [x / np.maximum(np.abs(x).max(axis=0), 1e-9) for x in motions]
        state = np.stack(relative, axis=-1)
        place, time = q / np.maximum(np.ptp(q, axis=0), 1e-9), segment.filtered_time
        slack, direction = np.abs(slack), np.sign(dq)
        return cls(segment, time, error, transient, slack, still, state, place, direction)

    @property
    def excess(self) -> Array:
        """Transient error beyond what dry friction may add (M, n), N·m.

        In motion it is at most the error: the columns that explain the errors of a joint that
        sticks at its reversals produce torque shortly after them, too, where the fit has no error.
        """
        found = np.abs(self.transient)
        found = np.where(self.still, found, np.minimum(found, np.abs(self.error)))
        return np.maximum(found - self.slack, 0.0)


def robust_scale(values: Array) -> float:
    """Return the standard deviation of the main part of values (k,), from their median size."""
    return float(1.4826 * np.median(np.abs(values))) if len(values) else 0.0


def _still(q: Array, segment: Processed) -> Mask:
    """Return where each joint stays in a small range for a while (M, n)."""
    time = segment.filtered_time
    step = float(time[1] - time[0]) if len(time) > 1 else 1.0
    width = max(int(STILL_TIME / step), 1)
    ranges = maximum_filter1d(q, width, axis=0) - minimum_filter1d(q, width, axis=0)
    return np.asarray(ranges < STILL_RANGE)


def _rests(still: Mask, segment: Processed) -> list[slice]:
    """Return the stretches in which the whole arm rests for a while."""
    time = segment.filtered_time
    ends = np.flatnonzero(np.diff(still.all(axis=1), prepend=False, append=False)).reshape(-1, 2)
    return [slice(a, b) for a, b in ends.tolist() if time[b - 1] - time[a] > RESTING]


def _late_torque(segment: Processed, torque: Array) -> Array:
    """Return filtered columns (M, n, k) of the model's torque (K, n), recorded late or filtered."""
    # a late change of dry friction at every reversal is a short error, but no contact
    count = max(round(2.0 * segment.cutoff * LATEST), 1)
    delays = LATEST * np.arange(1, count + 1) / count
    changes = [segment.filter(delayed_change(segment.t, torque, d)) for d in delays]
    return np.stack(changes, axis=-1)


def _without_columns(error: Array, columns: Array, moving: Mask) -> Array:
    """Return an error (M,), relative to its median at rest, without what columns (M, k) explain."""
    found = error.copy()
    if not moving.all():
        found[~moving] -= np.median(error[~moving])
    if moving.sum() < max(FEWEST_MOVING, 3 * columns.shape[1]):
        found[moving] -= np.median(error[moving]) if moving.any() else 0.0
        return found
    own = columns[moving] / np.maximum(np.linalg.norm(columns[moving], axis=0), 1e-12)
    target, weight = error[moving], np.ones(int(moving.sum()))
    rest = target
    for _ in range(ROUNDS):
        root = np.sqrt(weight)[:, None]
        rest = target - own @ np.linalg.lstsq(root * own, root[:, 0] * target, rcond=1e-8)[0]
        size = np.abs(rest) / max(BISQUARE * robust_scale(rest), 1e-12)
        weight = np.where(size < 1.0, (1.0 - np.minimum(size, 1.0) ** 2) ** 2, 0.0)
    found[moving] = rest
    return found


def returns_with_state(own: ResidualSignals, stretch: slice, joint: int) -> bool:
    """Return whether an error returns with the motion, or cannot be compared with other times."""
    near = _near(own.state[:, joint], SAME_STATE, own.excess[:, joint], stretch)
    visits, similar = _visits(own, stretch, joint, near, own.transient[:, joint])
    return visits < LEAST_VISITS or similar > MOST_SIMILAR * visits


def returns_with_position(own: ResidualSignals, stretch: slice, joint: int) -> bool:
    """Return whether an error returns on most passes through its positions, as at a rough spot.

    It has the same sign on all of them, or that of the velocity. A push of a joint that is held
    is none: the joint stays at one position.
    """
    if own.still[stretch, joint].any():
        return False
    error = own.transient[:, joint]
    near = _near(own.place[:, [joint]], SAME_PLACE, own.excess[:, joint], stretch)
    for signed in (error, error * own.direction[:, joint]):
        visits, similar = _visits(own, stretch, joint, near, signed)
        if 2 * similar > visits:
            return True
    return False


def _near(signals: Array, width: float, excess: Array, stretch: slice) -> Mask:
    """Return the rows (M,) whose signals (M, s) are those of a stretch where its error is large."""
    own = excess[stretch]
    large = stretch.start + np.flatnonzero(own > 0.5 * own.max())
    return np.asarray(KDTree(signals[large]).query(signals, p=np.inf)[0] < width)


def _visits(
    own: ResidualSignals, stretch: slice, joint: int, near: Mask, signed: Array
) -> tuple[int, int]:
    """Count the other passes through near rows, and those with an error of the peak's sign."""
    size, time = own.excess[:, joint], own.time
    at = stretch.start + int(np.argmax(size[stretch]))
    similar = (np.sign(signed) == np.sign(signed[at])) & (size > SIMILAR * size[at])
    where = np.flatnonzero(near & _apart(time, stretch))
    if not len(where):
        return 0, 0
    visit = np.cumsum(np.diff(time[where], prepend=time[where[0]]) > GAP)
    # A held joint makes one long visit: each second of it counts.
    visit = visit + np.floor(time[where]).astype(int) * (visit.max() + 1)
    _, number = np.unique(visit, return_inverse=True)
    returned = np.bincount(number, weights=similar[where]) > 0
    return len(returned), int(returned.sum())
