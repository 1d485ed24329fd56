"""Torque uncertainty from dry friction near velocity reversals and at rest.

The sign of a velocity within its noise of zero, or within half a sample of a reversal, is not
determined; at rest, friction has any value up to its level. The filter spreads this uncertainty
over neighbouring rows, where it could be mistaken for an effect at low speed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve
from scipy.special import erf

from lieid_casadi.compiled import Compiled
from lieid_casadi.recording.filtering import lowpass
from lieid_casadi.recording.processed import Processed

Array = NDArray[np.float64]
REST_VARIANCE = 1.0 / 3.0  # of a uniform distribution from −1 to 1
SLOW = 1e-9  # rad/s, on either side of a reversal
RESPONSE = 2.0  # periods of the cut-off, length of the filter's impulse response


def friction_torque_std(
    compiled: Compiled, segment: Processed, shapes: Array, parameters: Array
) -> Array:
    """Return the standard deviation (M, n) of filtered torque due to dry friction, N·m.

    Parameters
    ----------
    compiled : Compiled
    segment : Processed
        With M filtered instants.
    shapes : (s,)
        Shape parameters of the effects.
    parameters : (10 n + m,)
        Link parameters and effect coefficients, which determine the level of dry friction.
    """
    reach = min(round(RESPONSE * segment.rate / segment.cutoff), len(segment) - 1)
    impulse = np.zeros(2 * reach + 1)
    impulse[reach] = 1.0
    response = lowpass(impulse, segment.rate, segment.cutoff, segment.options.order)
    parts = []
    for window in segment.windows:
        at = window.instants
        level = dry_level(compiled, segment, at, shapes, parameters)
        moving = segment.moving[at]
        variance = np.where(moving, 1.0 - expected_sign(segment, at) ** 2, 0.0) * level**2
        spread = oaconvolve(variance, response[:, None] ** 2, mode="same", axes=0)[window.inside]
        rest = segment.filter_window(np.where(moving, 0.0, level), window)
        parts.append(np.sqrt(np.maximum(spread, 0.0) + REST_VARIANCE * rest**2))
    return np.concatenate(parts)


def expected_sign(segment: Processed, at: slice) -> Array:
    """Return the expected sign of the velocity (k, n), −1 to 1, at the instants ``at``.

    Torque and position are synchronous to half a sample at best.
    """
    ahead = 0.5 * np.abs(segment.ddq[at]) / segment.rate
    return np.asarray(erf(3.0 / np.sqrt(2.0) * segment.dq[at] / np.hypot(segment.dead_zone, ahead)))


def dry_level(
    compiled: Compiled, segment: Processed, at: slice, shapes: Array, parameters: Array
) -> Array:
    """Return half the jump of the effects' torque at a velocity reversal (k, n), N·m.

    Parameters
    ----------
    compiled : Compiled
    segment : Processed
    at : slice
        k instants of the segment.
    shapes : (s,)
    parameters : (10 n + m,)
        Link parameters and effect coefficients.
    """
    n, q = compiled.n, segment.q[at]
    signals: dict[str, Any] = {"shapes": shapes, "time": segment.t[at] - segment.t[0]}
    if segment.temperature is not None:
        signals["temperature"] = segment.temperature[at]
    if segment.command_error is not None:
        signals["command_error"] = segment.command_error[at]
    if any("load" in p.effect.signals for p in compiled.model.placements):
        motion = q, segment.dq[at], segment.ddq[at]
        signals["load"] = compiled.inverse_dynamics(*motion, parameters[: 10 * n])
    still, coefficients = np.zeros_like(q), parameters[10 * n :]
    forward, back = (
        compiled.friction(
            q, np.full_like(q, dq), still, coefficients, **signals, joint_effects_only=True
        )
        for dq in (SLOW, -SLOW)
    )
    return np.asarray(0.5 * np.abs(forward - back))
