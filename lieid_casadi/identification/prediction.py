"""Torque of a fitted model along a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled
from lieid_casadi.errors import ModelError
from lieid_casadi.identification.regression.segment_columns import model_along
from lieid_casadi.recording.processed import Processed, Processing, process
from lieid_casadi.recording.recording import Recording

HIGHEST_CUTOFF = 0.4  # of the recording's rate
FEWEST_SAMPLES = 5  # of a segment that can be filtered


def torque_along(
    compiled: Compiled,
    segment: Processed,
    parameters: Array,
    shapes: Array,
    *,
    fitted: bool = False,
) -> Array:
    """Return the model's torque (K, n) on a segment's grid, not filtered, N·m."""
    arm = model_along(compiled, segment, shapes, parameters, fitted=fitted)
    own = (arm.coefficients[k] * column for k, column in arm.arm_columns().items())
    return np.asarray(sum(own, start=arm.torque))


def training_rms(
    compiled: Compiled, segments: Sequence[Processed], parameters: Array, shapes: Array
) -> tuple[Array, Array]:
    """Return the RMS error on training segments per joint (n,), N·m: filtered, and on the grid.

    Temperatures are relative to those of the training recordings.
    """
    raw, filtered = [], []
    for segment in segments:
        assert segment.tau is not None  # checked before identification
        raw.append(segment.tau - torque_along(compiled, segment, parameters, shapes, fitted=True))
        filtered.append(segment.filter(raw[-1]))
    rms = [np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)) for errors in (filtered, raw)]
    return rms[0], rms[1]


def predict_recording(
    compiled: Compiled,
    recording: Recording,
    processing: Processing,
    parameters: Array,
    shapes: Array,
    temperature_mean: Array | None = None,
) -> Array:
    """Return the torque (N, n) at the recording's own times, N·m, finite in every row."""
    torque, first = np.zeros((len(recording.t), compiled.n)), 0
    for segment in recording.segments():
        here = slice(first, first + len(segment.t))
        first = here.stop
        for grid in _on_grid(segment, processing):
            warm = relative_temperature(grid, temperature_mean)
            with np.errstate(over="ignore", invalid="ignore"):  # checked below
                found = torque_along(compiled, warm, parameters, shapes)
            columns = [np.interp(segment.t, grid.t, column) for column in found.T]
            torque[here] = np.column_stack(columns)
    finite = np.isfinite(torque)
    if not finite.all():
        row, joint = np.argwhere(~finite)[0]
        raise ModelError(
            f"{recording.name or 'recording'}: the predicted torque of joint {joint + 1} at "
            f"t = {recording.t[row]:g} s is {torque[row, joint]}; expected a finite number: check "
            "the effects and parameters of the model, and the units of the recording"
        )
    return torque


def _on_grid(segment: Recording, processing: Processing) -> tuple[Processed, ...]:
    """Process one segment without trimming; use one too short for the filter as measured."""
    assert processing.cutoff is not None
    rate = segment.rate if len(segment.t) > 1 else 0.0
    cutoff = min(processing.cutoff, HIGHEST_CUTOFF * rate)
    if len(segment.t) >= FEWEST_SAMPLES and segment.duration * cutoff >= 1.0:
        return process(segment, replace(processing, cutoff=cutoff, trim=0.0))
    return (_as_measured(segment, processing),)


def _as_measured(segment: Recording, processing: Processing) -> Processed:
    """Return a segment at its own times; missing velocities and accelerations by differences."""
    t, q = segment.t, segment.q

    def derivative(x: Array) -> Array:
        return np.gradient(x, t, axis=0) if len(t) > 1 else np.zeros_like(x)

    dq = segment.dq if segment.dq is not None else derivative(q)
    ddq = segment.ddq if segment.ddq is not None else derivative(dq)
    return Processed(
        t=t, q=q, dq=dq, ddq=ddq, tau=segment.tau, temperature=segment.temperature,
        payload_label=None, recording=segment, rate=segment.rate if len(t) > 1 else 1.0,
        cutoff=processing.cutoff or 1.0, dead_zone=np.zeros(q.shape[1]), moving=dq != 0.0,
        options=processing, command=segment.command,
    )  # fmt: skip


def center_temperature(
    segments: Sequence[Processed], mean: Array | None = None
) -> tuple[tuple[Processed, ...], Array | None]:
    """Return segments with temperatures relative to a mean (n,), °C, and that mean.

    The mean is that over all segments if none is given. Segments are returned as they are if
    one of them has no temperature.
    """
    temperatures = [s.temperature for s in segments if s.temperature is not None]
    if len(temperatures) < len(segments):
        return tuple(segments), mean
    if mean is None:
        mean = np.concatenate(temperatures).mean(axis=0)
    return tuple(relative_temperature(segment, mean) for segment in segments), mean


def relative_temperature(segment: Processed, mean: Array | None) -> Processed:
    """Return a segment with temperatures relative to a mean (n,), °C."""
    if segment.temperature is None or mean is None:
        return segment
    return replace(segment, temperature=segment.temperature - mean)
