"""Torque of a fitted model along a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.effects import ArmEffect
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.torque import ArmInstant, arm_effect_columns
from lieid_casadi.identification.regression.segment_columns import effect_signals, effects_along
from lieid_casadi.recording.processed import Processed, Processing, process
from lieid_casadi.recording.recording import Recording

if TYPE_CHECKING:
    from lieid_casadi.identification.fit import Fit


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
    """Return the model's torque (K, n) on a segment's grid, not filtered, N·m.

    Parameters
    ----------
    segment : Processed
        With temperatures relative to those of the training recordings.
    parameters : (10 n + m,)
        Link parameters and the effects' coefficients.
    shapes : (s,)
        Shape parameters of the effects.
    fitted : bool
        Whether the parameters were fitted to this segment. Drift is predicted only then.
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
    """Yield measured − predicted torque of a training segment, N·m, part by part.

    Parameters
    ----------
    segment : Processed
        With torque.
    parameters : (10 n + m,)
        Link parameters and the effects' coefficients.
    shapes : (s,)
        Shape parameters of the effects.

    Yields
    ------
    (k, n) and (m, n)
        Errors on the segment's grid and filtered errors. Each instant is in one part.
    """
    assert segment.tau is not None  # checked before identification
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
        is_last = window.rows.stop == len(segment.filtered_time)
        first, last = last, at.stop if is_last else at.start + window.inside.stop
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
    """Return the torque (k, n) of effects on single joints, at the instants ``at``."""
    signals = effect_signals(segment, shapes, None)
    time, temperature = signals["time"][at], signals.get("temperature")
    error = signals.get("command_error")
    return compiled.effect_torque(
        segment.q[at],
        segment.dq[at],
        segment.ddq[at],
        parameters[10 * compiled.n :],
        load=rigid,
        temperature=None if temperature is None else temperature[at],
        time=time,
        command_error=None if error is None else error[at],
        shapes=shapes,
        dead_zone=signals["dead_zone"],
        joint_effects_only=True,
    )


def predict(fit: Fit, recording: Recording) -> Array:
    """Return the torque (N, n) of a fit at the recording's own times, N·m; finite everywhere.

    Parameters
    ----------
    fit : Fit
    recording : Recording
        Of N rows; torques are not needed.

    Returns
    -------
    (N, n) ndarray
        Torque of all effects, those on the measurement included, N·m.

    Raises
    ------
    ModelError, EffectError
        As `Fit.predict`.
    """
    return fit.predict(recording)


def predict_recording(
    compiled: Compiled,
    recording: Recording,
    processing: Processing,
    parameters: Array,
    shapes: Array,
    temperature_mean: Array | None = None,
) -> Array:
    """Return the torque (N, n) at the recording's own times, N·m, finite in every row.

    Parameters
    ----------
    processing : Processing
        With a cut-off.
    parameters : (10 n + m,)
        Link parameters and the effects' coefficients.
    shapes : (s,)
        Shape parameters of the effects.
    temperature_mean : (n,), optional
        Mean temperatures of the training recordings, °C.

    Raises
    ------
    ModelError
        A torque that is not finite.
    """

    def torque(segment: Processed) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):  # checked below
            return torque_along(compiled, segment, parameters, shapes)

    found = on_recording_times(recording, processing, temperature_mean, torque, compiled.n)
    finite = np.isfinite(found)
    if not finite.all():
        row, joint = np.argwhere(~finite)[0]
        raise ModelError(
            f"{recording.name or 'recording'}: the predicted torque of joint {joint + 1} at "
            f"t = {recording.t[row]:g} s is {found[row, joint]}; expected a finite number: check "
            "the effects and parameters of the model, and the units of the recording"
        )
    return found


def on_recording_times(
    recording: Recording,
    processing: Processing,
    temperature_mean: Array | None,
    function: Callable[[Processed], Array],
    width: int,
) -> Array:
    """Evaluate a function on processed segments; return its values at the recording's own times.

    Parameters
    ----------
    recording : Recording
        Of N samples.
    processing : Processing
        With a cut-off.
    temperature_mean : (n,) or None
        Mean temperatures of the training recordings, °C.
    function : callable
        Segment of K instants to values (K, width).
    width : int
        Number of values per instant.

    Returns
    -------
    (N, width) ndarray
        Interpolated linearly between the instants of the grid.
    """
    values = np.zeros((len(recording.t), width))
    first = 0
    for segment in recording.segments():
        here = slice(first, first + len(segment.t))
        first = here.stop
        for grid in _on_grid(segment, processing):
            found = function(relative_temperature(grid, temperature_mean))
            values[here] = np.column_stack(
                [np.interp(segment.t, grid.t, column) for column in found.T]
            )
    return values


def _on_grid(segment: Recording, processing: Processing) -> tuple[Processed, ...]:
    """Process one segment without trimming; use one too short for the filter as measured."""
    assert processing.cutoff is not None
    rate = segment.rate if len(segment.t) > 1 else 0.0
    cutoff = min(processing.cutoff, HIGHEST_CUTOFF * rate)
    if len(segment.t) >= FEWEST_SAMPLES and segment.duration * cutoff >= 1.0:
        options = replace(processing, cutoff=cutoff, trim=0.0, average_periods=False)
        return process(segment, options)
    return (_as_measured(segment, processing),)


def _as_measured(segment: Recording, processing: Processing) -> Processed:
    """Return a segment at its own times; missing velocities and accelerations by differences."""
    t, q = segment.t, segment.q

    def derivative(x: Array) -> Array:
        return np.gradient(x, t, axis=0) if len(t) > 1 else np.zeros_like(x)

    dq = segment.dq if segment.dq is not None else derivative(q)
    ddq = segment.ddq if segment.ddq is not None else derivative(dq)
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
        command=segment.command,
    )


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


def sample_torque(
    fit: Fit,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike,
    *,
    temperature: ArrayLike | None = None,
    time: ArrayLike | None = None,
) -> Array:
    """Return the torque (N, n) at samples; see `Fit.torque`.

    Parameters
    ----------
    q, dq, ddq : (N, n)
        rad, rad/s, rad/s² (m for a sliding joint).
    temperature : (N, n), optional
        °C.
    time : (N,), optional
        s.

    Raises
    ------
    ModelError
        A signal that an effect needs is not given, or an effect depends on the motion before the
        instant.
    """
    q, dq, ddq = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (q, dq, ddq))
    _require_signals(fit, temperature, time)
    if temperature is not None and fit.temperature_mean is not None:
        temperature = np.asarray(temperature, dtype=float) - fit.temperature_mean
    load = fit.compiled.inverse_dynamics(q, dq, ddq, fit.link_parameters)
    joints = fit.compiled.effect_torque(
        q,
        dq,
        ddq,
        fit.effect_coefficients,
        load=load,
        temperature=temperature,
        time=time,
        shapes=fit.shapes,
        joint_effects_only=True,
    )
    torque = np.asarray(load + joints)
    if not any(isinstance(p.effect, ArmEffect) for p in fit.model.placements):
        return torque
    change = _arm_effect_torque(fit)(*(x.T for x in (q, dq, ddq, load, torque)))
    return np.asarray(torque + change.full().T)


@lru_cache(maxsize=8)
def _arm_effect_torque(fit: Fit) -> ca.Function:
    """Return ``(q, dq, ddq, load, torque) -> change`` of effects not on single joints."""
    model = fit.model
    q, dq, ddq, load, torque = (
        ca.SX.sym(name, model.n) for name in ("q", "dq", "ddq", "load", "torque")
    )
    links = ca.SX(ca.DM(fit.link_parameters))
    coefficients = ca.SX(ca.DM(fit.effect_coefficients))
    arm = ArmInstant(model.robot, Motion.of(q, dq, ddq), links, load, torque)
    columns = [
        arm_effect_columns(model, arm, coefficients, measurement=measurement)
        for measurement in (False, True)
    ]
    change = ca.densify(ca.mtimes(columns[0] + columns[1], coefficients))
    return ca.Function("arm_effect_torque", [q, dq, ddq, load, torque], [change], {"cse": True})


def _require_signals(fit: Fit, temperature: ArrayLike | None, time: ArrayLike | None) -> None:
    for name, given in (("temperature", temperature), ("time", time)):
        needing = [p.label for p in fit.model.placements if name in p.effect.signals]
        if needing and given is None:
            raise ModelError(f"{', '.join(needing)}: expected {name}= beside the motion")
