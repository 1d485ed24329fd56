"""Torque of a fitted model along a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled import Compiled
from lieid_casadi.effects import ArmEffect
from lieid_casadi.identification.regression.segment_columns import effect_signals, effects_along
from lieid_casadi.recording.processing.process import Processed, Processing, process
from lieid_casadi.recording.recording import Recording

Array = NDArray[np.float64]
HIGHEST_CUTOFF = 0.4  # of the recording's rate


def torque_along(
    compiled: Compiled,
    segment: Processed,
    parameters: Array,
    shapes: Array,
    *,
    fitted: bool = False,
) -> Array:
    """Return the model's torque (K, n) on a segment's grid, not filtered.

    Parameters
    ----------
    parameters : (10 n + m,)
        Link parameters and the effects' coefficients.
    shapes : (s,)
    fitted : bool
        Whether the parameters come from this segment: drift does not carry over to others.
    """
    links = parameters[: 10 * compiled.n]
    rigid = compiled.inverse_dynamics(segment.q, segment.dq, segment.ddq, links)
    if not _needs_whole_segment(compiled):
        return rigid + _effect_torque(compiled, segment, parameters, shapes, rigid, slice(None))
    effects = effects_along(compiled, segment, shapes, parameters, fitted=fitted)
    return np.asarray(rigid + effects @ parameters[10 * compiled.n :])


def training_errors(
    compiled: Compiled, segment: Processed, parameters: Array, shapes: Array
) -> Iterator[tuple[Array, Array]]:
    """Yield measured − predicted torque of a segment that was fitted: not filtered, filtered.

    Window by window, (k, n) and (m, n), where the model allows it: every instant once.
    """
    assert segment.tau is not None
    whole = None
    if compiled.model.states or _needs_whole_segment(compiled):
        whole = segment.tau - torque_along(compiled, segment, parameters, shapes, fitted=True)
    links, last = parameters[: 10 * compiled.n], 0
    for window in segment.windows:
        at = window.instants
        if whole is not None:
            error = whole[at]
        else:
            rigid = compiled.inverse_dynamics(segment.q[at], segment.dq[at], segment.ddq[at], links)
            friction = _effect_torque(compiled, segment, parameters, shapes, rigid, at)
            error = segment.tau[at] - rigid - friction
        following = window.rows.stop == len(segment.filtered_time)
        first, last = last, at.stop if following else at.start + window.inside.stop
        yield error[first - at.start : last - at.start], segment.filter_window(error, window)


def _needs_whole_segment(compiled: Compiled) -> bool:
    return any(isinstance(p.effect, ArmEffect) for p in compiled.model.placements)


def _effect_torque(
    compiled: Compiled,
    segment: Processed,
    parameters: Array,
    shapes: Array,
    rigid: Array,
    at: slice,
) -> Array:
    """Return the torque (k, n) of effects that follow from the signals of each instant."""
    signals = effect_signals(segment, shapes, None)
    time, temperature = signals["time"][at], signals.get("temperature")
    return compiled.friction(
        segment.q[at],
        segment.dq[at],
        segment.ddq[at],
        parameters[10 * compiled.n :],
        load=rigid,
        temperature=None if temperature is None else temperature[at],
        time=time,
        shapes=shapes,
        dead_zone=signals["dead_zone"],
    )


def predict_recording(
    compiled: Compiled,
    recording: Recording,
    processing: Processing,
    parameters: Array,
    shapes: Array,
    temperature_mean: Array | None = None,
) -> Array:
    """Return the torque (N, n) at the recording's own times, finite in every row.

    Temperatures are referred to ``temperature_mean`` (n,), °C.
    """

    def torque(segment: Processed) -> Array:
        return torque_along(compiled, segment, parameters, shapes)

    return along_recording(recording, processing, temperature_mean, torque, compiled.n)


def along_recording(
    recording: Recording,
    processing: Processing,
    temperature_mean: Array | None,
    function: Callable[[Processed], Array],
    width: int,
) -> Array:
    """Return what a function of processed segments (K, width) says at the recording's times."""
    values = np.zeros((len(recording.t), width))
    for first, segment in _segments_with_start(recording):
        here = slice(first, first + len(segment.t))
        for grid in _on_grid(segment, processing):
            found = function(relative_temperature(grid, temperature_mean))
            values[here] = np.column_stack(
                [np.interp(segment.t, grid.t, column) for column in found.T]
            )
    return values


def relative_temperature(segment: Processed, mean: Array | None) -> Processed:
    """Return a segment whose temperatures are relative to a mean (n,), °C."""
    if segment.temperature is None or mean is None:
        return segment
    return replace(segment, temperature=segment.temperature - mean)


def _segments_with_start(recording: Recording) -> list[tuple[int, Recording]]:
    found, first = [], 0
    for segment in recording.segments():
        found.append((first, segment))
        first += len(segment.t)
    return found


def _on_grid(segment: Recording, processing: Processing) -> tuple[Processed, ...]:
    """Process one segment whole; one too short for the filter is used as it was measured."""
    assert processing.cutoff is not None
    rate = segment.rate if len(segment.t) > 1 else 0.0
    cutoff = min(processing.cutoff, HIGHEST_CUTOFF * rate)
    if len(segment.t) >= 5 and segment.duration * cutoff >= 1.0:
        options = replace(processing, cutoff=cutoff, trim=0.0, average_periods=False)
        return process(segment, options)
    return (_as_measured(segment, processing),)


def _as_measured(segment: Recording, processing: Processing) -> Processed:
    t, q = segment.t, segment.q
    still = np.zeros_like(q)
    slope = (lambda x: np.gradient(x, t, axis=0)) if len(t) > 1 else (lambda x: still)
    dq = segment.dq if segment.dq is not None else slope(q)
    ddq = segment.ddq if segment.ddq is not None else slope(dq)
    return Processed(
        t=t,
        q=q,
        dq=dq,
        ddq=ddq,
        tau=segment.tau,
        temperature=segment.temperature,
        payload_label=None,
        recording=segment,
        rate=segment.rate if len(t) > 1 else 1.0,
        cutoff=processing.cutoff or 1.0,
        dead_zone=np.zeros(q.shape[1]),
        moving=dq != 0.0,
        options=processing,
    )
