"""Noise floor: the RMS error in motion of a model that lacks nothing, after the fit's filter.

This is the only definition; comparisons, diagnoses, their pictures and reports use it. Noise is
what does not depend on the motion. It is estimated from the difference between periods where all
recordings are periodic (`period_noise`), and otherwise as the part of the error that no function of
the motion explains: the model's own columns and common effects (`motion_columns`), alone or with
couplings of the joints (`coupling_columns`), by ridge regression whose penalty is chosen on
held-out blocks of time. Functions of the motion explain a part of slow noise by chance: an error
counts as noise unless they explain more of it than of the same error at every other time of the
motion (shifted surrogates; Theiler et al., Physica D 1992). Nor is an error noise that follows
slow functions of time, or dry friction that changes so, far more than noise with the spectrum of
the rest would. Positions do not show to a sample when dry friction reverses: the floor contains
what the error has beside reversals alone, as far as friction is uncertain there. On recordings that
the fit did not use it contains the error of its uncertain parameters, up to a multiple of the rest:
with more, training data are missing. It never exceeds the error itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import JointRows, Rows, independent_axes
from lieid_casadi.identification.regression.variable_projection import shape_columns
from lieid_casadi.identification.uncertainty.covariance import square_root
from lieid_casadi.identification.uncertainty.noise_model import (
    common_effect_columns,
    friction_torque_std,
    noise_of,
    runs_of,
)
from lieid_casadi.recording import Recording, period_noise
from lieid_casadi.recording.processed import Processed

PENALTIES = np.logspace(-8.0, 3.0, 23)  # relative to the mean square of a column
BLOCK, FOLDS = 1.0, 5  # s (less in short recordings), number: blocks go to the folds in turn
BANDWIDTH = 0.5  # of the sampled band that the low-pass filter leaves: independent rows
DEPENDENT = 0.8  # of the mean square error: with less on held-out blocks, the error depends on …
FEWEST_ROWS = 2.0  # … the motion, and columns are fitted without penalty; rows per column
LEAST_ROWS = 40  # in motion, for an estimate
DEPENDENCE = 1e-5  # of a largest singular value
LEAST_LEFT = 0.1  # of a band of frequencies: with less its noise is not known
BAND = 9  # frequencies
SHIFTS = 15  # of the error against the motion
MOST_UNCERTAIN = 3.0  # error of uncertain parameters in a floor, relative to the rest of it
WAVES, FASTEST = 5, 0.2  # half periods of slow functions of time in a segment; Hz
#: Square of an error in slow functions of time, relative to the variance along one of them of noise
#: with the spectrum of the rest, from which it is not noise. It is large because 15 s show badly
#: the spectrum of noise that is correlated over 1 s: 2 of 320 joints exceed it, 16 of 200 half.
NOT_NOISE = 1000.0

SOURCES = {
    "period_to_period": "differences between periods of the motion",
    "motion": "part of the error that no function of the motion, nor a slow one of time, explains",
    "none": "not available",
}


def noise_floor(
    fit: Fit, recordings: Sequence[Recording], segments: Sequence[Processed], error: Array
) -> tuple[Array, str]:
    """Return the noise of the torque after the fit's filter (n,), N·m, and its key of `SOURCES`.

    ``segments`` are those of the recordings, ``error`` (n,) is the RMS error in motion, N·m. The
    noise is NaN for joints that hardly move.
    """
    cutoff, design = segments[0].cutoff, Design(fit.compiled, segments)
    rows = design.rows(fit.shapes, fit.parameters)
    unseen = [s.number is None for s in segments]
    residuals = rows.residuals(fit.values)
    repeated = [period_noise(r, cutoff=cutoff) for r in recordings]
    squares = [noise**2 for noise in repeated if noise is not None]
    if len(squares) == len(recordings):  # else rates and noise of the others may be unlike
        durations = [r.duration for r in recordings]
        floor = np.asarray(np.sqrt(np.average(squares, axis=0, weights=durations)))
        source = "period_to_period"
    else:
        source = "motion"
        floor = _independent_of_motion(fit, segments, rows, residuals, unseen=all(unseen))
    floor = np.minimum(floor, _without_slow(segments, rows, residuals))
    floor = np.hypot(floor, _uncertain_friction(fit, segments, rows, residuals, floor))
    if any(unseen):
        lengths = [len(s.filtered_time) for s in segments]
        # the covariance is that of the fit's residual, which contains a missing effect as well
        size = np.minimum(floor / np.maximum(fit.noise, 1e-300), 1.0)
        part = np.average(unseen, weights=lengths)
        uncertain = np.sqrt(part) * size * _uncertainty(fit, design, rows)
        floor = np.hypot(floor, np.minimum(uncertain, MOST_UNCERTAIN * floor))
    floor = np.where(np.isfinite(error), np.minimum(floor, error), np.nan)
    return floor, source if np.isfinite(floor).any() else "none"


def _independent_of_motion(
    fit: Fit, segments: Sequence[Processed], rows: Rows, residuals: Sequence[Array], *, unseen: bool
) -> Array:
    """Return the RMS of what columns of the motion do not explain (n,), N·m.

    On recordings that are ``unseen`` the error of the fit's parameters depends on the motion: what
    else does is examined beside it.
    """
    columns = np.concatenate([motion_columns(fit, segment) for segment in segments])
    couplings = np.concatenate([coupling_columns(segment) for segment in segments])
    time = segments[0].filtered_time
    step = float(time[1] - time[0]) if len(time) > 1 else BLOCK
    block = max(min(round(BLOCK / step), int(rows.segments[-1]) // (2 * FOLDS)), 1)
    floors = []
    for j, (joint, residual) in enumerate(zip(rows.joints, residuals, strict=True)):
        own = np.column_stack([joint.matrix, columns[joint.instant, j]])
        both = own, np.column_stack([own, couplings[joint.instant]])
        fold = joint.instant // block % FOLDS
        if len(np.unique(fold)) < FOLDS or len(residual) <= LEAST_ROWS:
            floors.append(np.nan)
            continue
        square = _noise_square(both, residual, fold)
        if unseen and square < np.mean(residual**2):
            square = max(square, _noise_square(both, _refitted(joint.matrix, residual), fold))
        floors.append(np.sqrt(square))
    return np.array(floors)


def _noise_square(columns: Sequence[Array], residual: Array, fold: Indices) -> float:
    """Return the mean square of a residual (R,), or of what none of several columns explain.

    Both are upper bounds: short recordings do not determine the coefficients of all columns.
    """
    shifts = [round(k * len(residual) / (SHIFTS + 1)) for k in range(SHIFTS + 1)]
    errors = np.column_stack([np.roll(residual, shift) for shift in shifts])
    part, *by_chance = np.minimum.reduce([_unexplained(own, errors, fold) for own in columns])
    return float(np.mean(residual**2)) * (float(part) if part < min(by_chance) else 1.0)


def _refitted(matrix: Array, residual: Array) -> Array:
    """Return a residual (R,) outside the span of a model, as large as white noise was inside."""
    basis = independent_axes(matrix, tolerance=DEPENDENCE)[0]
    left = 1.0 - basis.shape[1] / (BANDWIDTH * max(len(residual), 1))
    if left < LEAST_LEFT:
        return residual
    return np.asarray((residual - basis @ (basis.T @ residual)) / np.sqrt(left))


def _without_slow(segments: Sequence[Processed], rows: Rows, residuals: Sequence[Array]) -> Array:
    """Return the RMS (n,) of what slow functions of time leave, where these are no noise, N·m."""
    floors = []
    direction = np.concatenate([_direction(segment) for segment in segments])
    for j, residual in enumerate(residuals):
        slow = _slow_part(segments, rows.joints[j], residual, direction[:, [j]])
        square = np.mean(residual**2) if len(residual) else np.inf
        floors.append(np.sqrt(square * (1.0 - slow)))
    return np.array(floors)


def _slow_part(
    segments: Sequence[Processed], joint: JointRows, residual: Array, direction: Array
) -> float:
    """Return the part of a residual's squares (R,) that changes slowly with time, 0 if it is noise.

    That is torque, and dry friction in the ``direction`` (N, 1) of the motion.
    """
    count = len(direction)
    line = np.zeros(count)
    line[joint.instant] = residual
    usable = np.zeros((count, 1), dtype=bool)
    usable[joint.instant] = True
    (run,) = runs_of(usable, segments, np.zeros((count, 1)))
    target = line[run.all]
    total = float(target @ target)
    if total == 0.0:
        return 0.0
    time = np.concatenate([s.filtered_time for s in segments])
    segment_of = np.repeat(np.arange(len(segments)), [len(s.filtered_time) for s in segments])
    columns = np.hstack(slow_functions(time[run.all], segment_of[run.all]))
    model = np.zeros((count, joint.matrix.shape[1]))
    model[joint.instant] = joint.matrix
    basis, found = independent_axes(model[run.all], tolerance=DEPENDENCE)[0], 0.0
    target -= basis @ (basis.T @ target)  # on unseen recordings it contains errors of parameters
    for own in (columns, columns * direction[run.all]):
        axes = independent_axes(own - basis @ (basis.T @ own), tolerance=DEPENDENCE)[0]
        along = axes.T @ target
        rest = target - axes @ along
        if not 0 < FEWEST_ROWS * axes.shape[1] < len(target):
            continue
        noise = noise_of(rest, run)
        white, coloured = noise.variances(axes)
        slow = float(along @ along)
        if slow > NOT_NOISE * noise.spread**2 * float(np.mean(coloured / white)):
            found, target = found + slow, rest
    return found / total


def slow_functions(time: Array, segment_of: Indices) -> list[Array]:
    """Return slow functions of time (R, k) of each segment: cosines and sines in turn."""
    found = []
    for k in np.unique(segment_of):
        here = segment_of == k
        place = time[here] - time[here].min()
        length = max(float(place.max()), 1e-9)
        waves = np.arange(1, min(WAVES, int(2.0 * FASTEST * length)) + 1)
        phase = np.pi * np.outer(place / length, waves)
        found.append(np.zeros((len(time), 2 * len(waves))))
        found[-1][here] = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(place), -1)
    return found


def _uncertain_friction(
    fit: Fit, segments: Sequence[Processed], rows: Rows, residuals: Sequence[Array], noise: Array
) -> Array:
    """Return the RMS (n,) by which the error beside reversals leaves its course around them, N·m.

    It is at most that of uncertain friction, and beyond the error elsewhere.
    """
    friction = np.concatenate(
        [friction_torque_std(fit.compiled, s, fit.shapes, fit.parameters) for s in segments]
    )
    found = []
    for j, residual in enumerate(residuals):
        instant = rows.joints[j].instant
        own = friction[instant, j]
        here = own > noise[j]
        if not here.any() or here.all():
            found.append(0.0)
            continue
        course = np.interp(instant[here], instant[~here], residual[~here])
        beyond = np.mean((residual[here] - course) ** 2) - np.mean(residual[~here] ** 2)
        found.append(np.sqrt(np.clip(np.mean(here) * beyond, 0.0, np.mean(own**2))))
    return np.array(found)


def _uncertainty(fit: Fit, design: Design, rows: Rows) -> Array:
    """Return the RMS standard deviation of the predicted torque (n,), N·m."""
    count, root = len(fit.values), square_root(fit.covariance)
    slopes = shape_columns(design, fit.values, fit.shapes, fit.parameters)
    found = []
    for joint, of_shapes in zip(rows.joints, slopes, strict=True):
        own = np.append(joint.columns, count + np.arange(len(fit.shapes)))
        variance = np.sum((np.hstack([joint.matrix, of_shapes]) @ root[own]) ** 2, axis=1)
        found.append(np.sqrt(np.mean(variance)) if len(variance) else 0.0)
    return np.array(found)


def _unexplained(columns: Array, errors: Array, fold: Indices) -> Array:
    """Return the part (S,) of the squares of errors (N, S) that columns (N, k) do not explain."""
    size = np.sqrt(np.mean(columns**2, axis=0))
    scaled = columns[:, size > 0.0] / size[size > 0.0]
    count, total = len(errors), np.maximum(np.mean(errors**2, axis=0), 1e-300)
    independent = BANDWIDTH * count
    held_out = np.sum([_held_out(scaled, errors, fold == k) for k in range(FOLDS)], axis=0) / count
    best = np.argmin(held_out, axis=0)
    spread = np.maximum(np.linalg.eigvalsh(scaled.T @ scaled / count), 0.0)
    used = np.sum((spread / (spread + PENALTIES[best][:, None])) ** 2, axis=1)
    # held-out errors contain the uncertainty of the columns' coefficients
    square = held_out.min(axis=0) / (1.0 + used * FOLDS / (FOLDS - 1) / independent)
    if independent > FEWEST_ROWS * scaled.shape[1]:
        rest = _beside(scaled, errors)
        square = np.where(square < DEPENDENT * total, np.minimum(square, rest), square)
    return np.asarray(np.minimum(square / total, 1.0))


def _beside(columns: Array, errors: Array) -> Array:
    """Return the mean squares (S,) of noise in errors (N, S), part of which columns (N, k) take.

    Least squares take a part of the noise from each band: that which the columns' span has of it.
    """
    axes = independent_axes(columns, tolerance=DEPENDENCE)[0]
    rest = errors - axes @ (axes.T @ errors)
    left = 1.0 - _in_bands(axes).sum(axis=1)
    powers = _in_bands(rest) / np.maximum(left, LEAST_LEFT)[:, None]
    return np.asarray(powers.sum(axis=0) / len(columns))


def _in_bands(values: Array) -> Array:
    """Return the mean squares (F, S) of columns (N, S) at frequencies, averaged over bands."""
    power = np.abs(np.fft.fft(values, axis=0)) ** 2 / len(values)
    return np.asarray(uniform_filter1d(power, BAND, axis=0, mode="wrap"))


def _held_out(columns: Array, errors: Array, out: Mask) -> Array:
    """Return the sums of squared errors (P, S) of held-out rows, one for each of `PENALTIES`."""
    inside, count = columns[~out], int(np.sum(~out))
    spread, axes = np.linalg.eigh(inside.T @ inside / count)
    values = axes.T @ (inside.T @ errors[~out] / count)
    along, target = columns[out] @ axes, errors[out]
    weights = 1.0 / (np.maximum(spread, 0.0) + PENALTIES[:, None])
    found = weights[:, :, None] * values
    fall = np.sum(found * (2.0 * (along.T @ target) - (along.T @ along) @ found), axis=1)
    return np.asarray(np.maximum(np.sum(target**2, axis=0) - fall, 0.0))


STEEP = 10.0  # of the smoothed sign of a joint's velocity, relative to its top speed


def motion_columns(fit: Fit, segment: Processed) -> Array:
    """Return filtered functions of the motion along a segment (M, n, k).

    Those of common effects of a joint's own motion, of the rate of its torque (a delay), of its
    position, and of the velocities and directions of all joints (couplings).
    """
    links = fit.link_parameters
    q, dq = (segment.filter(x) for x in (segment.q, segment.dq))
    load = segment.filter(fit.compiled.inverse_dynamics(segment.q, segment.dq, segment.ddq, links))
    time = segment.filtered_time
    torque = segment.filter(torque_along(fit.compiled, segment, fit.parameters, fit.shapes))
    rate = np.gradient(torque, time, axis=0) if len(time) > 1 else np.zeros_like(load)
    direction = _direction(segment)
    own = [np.ones_like(q), direction, np.abs(dq), q, load, rate, np.sin(2 * q), np.cos(2 * q)]
    others = np.concatenate([dq, direction], axis=1)
    return np.concatenate(
        [
            common_effect_columns(fit.compiled, segment, links),
            np.stack(own, axis=-1),
            np.repeat(others[:, None], fit.model.n, axis=1),
        ],
        axis=-1,
    )


def _direction(segment: Processed) -> Array:
    """Return the smoothed signs (M, n) of the velocities along a segment."""
    dq = segment.filter(segment.dq)
    return np.asarray(np.tanh(STEEP * dq / np.maximum(np.abs(dq).max(axis=0), 1e-9)))


def coupling_columns(segment: Processed) -> Array:
    """Return filtered positions and products of two velocities along a segment (M, n + n(n+1)/2).

    Springs between joints, and torque of wrong kinematics, follow them on every joint.
    """
    first, second = np.triu_indices(segment.n)
    products = segment.dq[:, first] * segment.dq[:, second]
    return np.concatenate([segment.filter(segment.q), segment.filter(products)], axis=1)
