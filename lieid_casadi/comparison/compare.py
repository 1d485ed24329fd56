"""Compare a fit with recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lieid_casadi import errors
from lieid_casadi.arrays import Array, Mask
from lieid_casadi.comparison.comparison import Comparison
from lieid_casadi.comparison.noise_floor import noise_floor
from lieid_casadi.comparison.series import largest_errors, series_along
from lieid_casadi.identification import recording_checks
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.identification.regression.design_matrix import usable_rows
from lieid_casadi.identification.regression.variable_projection import signal_of
from lieid_casadi.recording import Processed, Recording, check, process
from lieid_casadi.recording.recording import listed

BEYOND = 0.1  # of the samples outside a range of training from which they are reported


def compare(fit: Fit, recordings: Recording | Sequence[Recording]) -> Comparison:
    """Compare a fit's torque with what was measured.

    Parameters
    ----------
    fit : Fit
    recordings : Recording or sequence of Recording
        With torques, preferably not used to fit the model. All recordings together give one
        number per joint.

    Returns
    -------
    Comparison

    Raises
    ------
    RecordingError
        A recording that is certainly wrong, or too short or too slow for the fit's filter.
    ModelError, EffectError
        A recording without torque, with another number of joints, or without a signal that
        an effect needs.
    """
    given = listed(recordings)
    recording_checks.check_recordings(fit.model, given)
    found = [w for recording in given for w in check(recording, fit.model.robot)]
    found += [w for r in given for w in recording_checks.check_torque_constants(fit.provenance, r)]
    return compare_segments(fit, given, compared_segments(fit, given), warnings=found)


def compared_segments(fit: Fit, recordings: Sequence[Recording]) -> tuple[Processed, ...]:
    """Return segments, processed as those of a fit but for averaged periods, with its numbers."""
    segments, _ = center_temperature(process(recordings, fit.processing), fit.temperature_mean)
    return tuple(replace(s, number=fit.provenance.number(Source.of(s.recording))) for s in segments)


def compare_segments(
    fit: Fit,
    recordings: Sequence[Recording],
    segments: Sequence[Processed],
    *,
    warnings: Sequence[errors.LieidWarning] = (),
    with_noise: bool = True,
) -> Comparison:
    """Compare a fit with segments of recordings that were checked and processed before.

    Temperatures of the segments are relative to the fit's mean. Without ``with_noise``, the noise
    floor, which takes as long as the rest, is NaN.
    """
    both = [series_along(fit, segment) for segment in segments]
    series = tuple(each for each, _ in both)
    measured = np.concatenate([s.measured for s in series])
    predicted = np.concatenate([s.predicted for s in series])
    moving = np.concatenate([s.moving for s in series])
    error = measured - predicted
    rms, torque_rms = _rms(error), _rms(measured)
    used = np.concatenate([usable_rows(fit.model, segment) for segment in segments])
    rms_moving = _rms_where(error, moving & used)
    floor, source = np.full(fit.model.n, np.nan), "none"
    if with_noise:
        floor, source = noise_floor(fit, recordings, segments, rms_moving)
    comparison = Comparison(
        joint_names=tuple(joint.name for joint in fit.model.robot.joints),
        units=tuple("N·m" if joint.revolute else "N" for joint in fit.model.robot.joints),
        rms=rms,
        rms_raw=_rms(np.concatenate([raw for _, raw in both])),
        rms_moving=rms_moving,
        rms_at_rest=_rms_where(error, ~moving),
        at_rest=1.0 - moving.mean(axis=0),
        torque_rms=torque_rms,
        relative_rms=_ratio(rms, torque_rms),
        correlation=_correlation(measured, predicted),
        bias=error.mean(axis=0),
        noise_floor=floor,
        noise_source=source,
        worst=largest_errors(series),
        series=series,
        cutoff=segments[0].cutoff,
        recordings=tuple(recording_checks.Source.of(r) for r in recordings),
        duration=float(sum(s.time[-1] - s.time[0] for s in series)),
        warnings=(),
    )
    found = [*warnings, *(w for segment in segments for w in segment.warnings)]
    found += [*_trained_on(fit, comparison), *_beyond_training(fit, segments)]
    return replace(comparison, warnings=errors.unique_warnings(found))


def _rms(error: Array) -> Array:
    """Return the RMS of each column."""
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def _rms_where(error: Array, use: Mask) -> Array:
    """Return the RMS per joint over the marked samples (n,), NaN where none is marked."""
    count = use.sum(axis=0)
    squares = np.sum(np.where(use, error, 0.0) ** 2, axis=0)
    return np.where(count > 0, np.sqrt(squares / np.maximum(count, 1)), np.nan)


def _ratio(part: Array, whole: Array) -> Array:
    return np.where(whole > 0.0, part / np.where(whole > 0.0, whole, 1.0), np.nan)


def _correlation(a: Array, b: Array) -> Array:
    """Return the correlation of each pair of columns (n,), NaN where one is constant."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    norm = np.sqrt(np.sum(a**2, axis=0) * np.sum(b**2, axis=0))
    return _ratio(np.sum(a * b, axis=0), norm)


def _trained_on(fit: Fit, comparison: Comparison) -> list[errors.LieidWarning]:
    again = [
        source.name or "a recording"
        for source in comparison.recordings
        if fit.provenance.contains(source)
    ]
    if not again:
        return []
    return [
        errors.SameRecordingWarning(
            f"{', '.join(again)} was used to fit the model: errors are training errors and smaller "
            "than on other recordings; compare with a recording that was not used"
        )
    ]


def _beyond_training(fit: Fit, segments: Sequence[Processed]) -> list[errors.LieidWarning]:
    """Return a warning for each smooth function that the motion leaves: it is zero out there."""
    found: list[errors.LieidWarning] = []
    for slot in fit.model.slots:
        placement, outside, ranges = slot.placement, [], []
        for shape, end in zip(placement.effect.shapes, fit.shapes[slot.shapes], strict=True):
            if shape.data is None:
                continue
            values = signal_of(shape.data, placement.joint, segments)
            if values is None:
                continue
            beyond = {"low": values < end, "high": values > end, "size": np.abs(values) > end}
            outside.append(beyond[shape.data.end])
            ranges.append(f"{shape.name} = {end:.3g} {shape.unit}")
        part = float(np.mean(np.any(outside, axis=0))) if outside else 0.0
        if part > BEYOND:
            found.append(
                errors.BeyondTrainingWarning(
                    f"{100 * part:.0f} % of the samples are outside the range in which "
                    f"{placement.label} was trained ({', '.join(ranges)}), and it falls to zero "
                    "there: train with motion through the whole range"
                )
            )
    return found
