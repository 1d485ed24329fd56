"""Transient errors: contact, collisions and faults of the recorder, not properties of the arm.

An error is transient if it is far beyond the spread of the errors around it, if functions of the
joint's own motion do not explain it, and if the joint passes through the same velocity,
acceleration and load at other times without it, and through the same position, too. A property of
the arm returns with the motion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.events.event import Event, Kind
from lieid_casadi.diagnosis.events.residual_signals import (
    FEWEST_MOVING,
    ResidualSignals,
    robust_scale,
)
from lieid_casadi.diagnosis.events.returning_errors import (
    Stretch,
    returns_with_position,
    returns_with_state,
)
from lieid_casadi.diagnosis.events.tool_force import tool_force
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.messages import joints_text
from lieid_casadi.recording import Recording, process

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
LAG = 4  # samples, one period of the cut-off: independent noise
LEAST_SCALE = 1e-3  # of the RMS of a joint's torque
FEWEST_FROZEN = 10  # rows with one and the same torque on every joint
SPIKE_ROWS = 3  # rows: a shorter error is a fault of the recorder


def transient_events(
    fit: Fit, recordings: Sequence[Recording], options: DiagnosisOptions
) -> tuple[Event, ...]:
    """Return the transient errors of a fit along recordings.

    Parameters
    ----------
    fit : Fit
    recordings : sequence of Recording
        With torques.
    options : DiagnosisOptions

    Returns
    -------
    tuple of Event
        In the order of the recordings and of time.
    """
    segments, _ = center_temperature(process(recordings, fit.processing), fit.temperature_mean)
    signals = [ResidualSignals.of(fit, segment) for segment in segments]
    scale = _scale(signals)
    found: list[Event] = []
    for own in signals:
        size = own.excess / scale
        errors = [e for j in range(fit.model.n) for e in _outstanding(own, size, j, options)]
        events = _together(errors, own.time, options)
        if sum(e.last - e.first for e in events) <= options.most_event_time * len(own.time):
            found += [_event(fit, own, scale, event, options) for event in events]
    return tuple(found)


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


def _outstanding(
    own: ResidualSignals, size: Array, joint: int, options: DiagnosisOptions
) -> list[Stretch]:
    """Return the errors of a joint that are far above all others and not due to its motion."""
    peaks = _peaks(own.time, size[:, joint], options)
    sizes = np.array([size[k, joint] for k in peaks])
    ratios = sizes[:-1] / np.maximum(sizes[1:], 1.0)
    usable = np.flatnonzero((sizes[:-1] > options.least_event) & (ratios > options.event_ratio))
    if not len(usable):
        return []
    peaks = peaks[: int(usable[-1]) + 1]
    stretches = [_around(size[:, joint], k, options) for k in peaks]
    inside = np.zeros(len(size), dtype=bool)
    for stretch in stretches:
        inside[stretch.first : stretch.last] = True
    return [
        stretch
        for stretch in stretches
        if _fault(own, stretch)
        or not (
            returns_with_state(own, stretch, joint, inside, options)
            or returns_with_position(own, stretch, joint, options)
        )
    ]


def _peaks(time: Array, size: Array, options: DiagnosisOptions) -> list[int]:
    """Return the rows of the largest values that are apart from each other, largest first."""
    allowed = np.ones(len(size), dtype=bool)
    found: list[int] = []
    while allowed.any():
        k = int(np.argmax(np.where(allowed, size, -1.0)))
        found.append(k)
        if size[k] < options.least_event:
            break
        stretch = _around(size, k, options)
        allowed &= (time < time[stretch.first] - options.event_gap) | (
            time > time[stretch.last - 1] + options.event_gap
        )
    return found


def _around(size: Array, peak: int, options: DiagnosisOptions) -> Stretch:
    """Return the rows around a peak until the error is small."""
    low = size < max(options.least_event_end, options.event_end_part * size[peak])
    before, after = np.flatnonzero(low[:peak]), np.flatnonzero(low[peak:])
    first = int(before[-1]) + 1 if len(before) else 0
    last = peak + int(after[0]) if len(after) else len(size)
    return Stretch(first, last)


def _together(errors: Sequence[Stretch], time: Array, options: DiagnosisOptions) -> list[Stretch]:
    """Return the stretches in the order of time, those that overlap or nearly so joined."""
    joined: list[Stretch] = []
    for error in sorted(errors, key=lambda e: e.first):
        if joined and time[error.first] - time[joined[-1].last - 1] < options.event_gap:
            before = joined.pop()
            last = max(before.last, error.last)
            joined.append(Stretch(before.first, last))
        else:
            joined.append(error)
    return joined


def _event(
    fit: Fit, own: ResidualSignals, scale: Array, stretch: Stretch, options: DiagnosisOptions
) -> Event:
    rows = slice(stretch.first, stretch.last)
    joints = tuple(
        int(j) for j in np.flatnonzero((own.excess / scale)[rows].max(axis=0) > options.least_event)
    )
    start, end = float(own.time[rows.start]), float(own.time[rows.stop - 1])
    peak = float(np.abs(own.transient[rows][:, joints]).max())
    segment = own.segment
    kind: Kind = "contact"
    force = None
    reason = _fault(own, stretch)
    if reason:
        kind = "fault"
    else:
        force = tool_force(fit, own, scale, rows) if len(joints) > 1 else None
        reason = "contact or a collision"
        if force is not None:
            x, y, z = force
            reason += (
                f", consistent with a force of {np.linalg.norm(force):.3g} N on the tool "
                f"({x:.3g}, {y:.3g}, {z:.3g} N in the base frame)"
            )
    name = segment.recording.name or "recording"
    where = joints_text(j in joints for j in range(fit.model.n))
    sentence = (
        f"{name}, {start:.1f}–{end:.1f} s: error of up to {peak:.3g} N·m on {where} "
        f"that the motion does not explain: {reason}; this stretch is left out."
    )
    source = Source(name, segment.recording.source_hash)
    return Event(kind, source, start, end, joints, peak, sentence, force)


def _fault(own: ResidualSignals, stretch: Stretch) -> str:
    """Return what shows a fault of the recorder in a stretch, or an empty text."""
    segment, raw = own.segment, own.segment.recording
    assert raw.tau is not None
    start, end = own.time[stretch.first], own.time[stretch.last - 1]
    margin = 0.5 / segment.cutoff
    rows = np.flatnonzero((raw.t >= start - margin) & (raw.t <= end + margin))
    tau = raw.tau[rows]
    if len(rows) < 2:
        return ""
    same = np.all(np.diff(tau, axis=0) == 0.0, axis=1)
    run = np.diff(np.flatnonzero(np.concatenate([[True], ~same, [True]]))).max()
    if run >= FEWEST_FROZEN:
        return f"{run} samples have the same torque on every joint, a fault of the recorder"
    middle = np.median(tau, axis=0)
    away = np.abs(tau - middle)
    far = np.any(away > 0.5 * away.max(axis=0) + 1e-12, axis=1) & np.any(
        away > 10.0 * np.median(away, axis=0) + 1e-9, axis=1
    )
    if 0 < far.sum() <= SPIKE_ROWS:
        return f"single samples ({far.sum()}) far from their neighbours, a fault of the recorder"
    return ""
