"""A torque that is recorded with a delay."""

from collections.abc import Callable
from functools import partial

import numpy as np

from lieid_casadi.arrays import Mask
from lieid_casadi.effects.arm_effect import ArmEffect, Array, SegmentModel, on_joint
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register

LEAST = 1e-3  # s; below it the column is the derivative, not the difference quotient


@register
class TorqueDelay(ArmEffect):
    """The torque is recorded late: τ_measured(t) = τ(t − δ), δ in s.

    Confused with viscous friction and armature; a lead below one sampling interval cannot be
    distinguished from a velocity that the drive computes by differences. Exported code computes the
    torque at the instant, without the delay.
    """

    name = "torque_delay"
    finding = (
        "The measured torque of {joints} lags behind the position",
        "The measured torque of {joints} leads the position",
    )
    formula = "τ_measured(t) = τ(t − δ)"
    coefficients = (Coefficient("delta", "s", limit=0.1, meaning="delay", resolved_by="lead"),)
    reach = "joint"
    needs_past = True
    on_torque_signal = True
    like_uncertain_friction = ("late",)
    export_note = "omitted: the torque is that of the instant, without the delay of its measurement"
    trial_values = ((-0.02,), (-0.005,), (0.005,), (0.01,), (0.02,), (0.04,), (0.08,))
    revealed_by = "fast changes of torque: high accelerations, reversals, rates above 100 Hz"
    confused_with = {
        "viscous": "a delayed inertia torque resembles damping; vary the frequency",
        "armature": "a delayed damping torque resembles inertia; vary the frequency",
        "torque_lowpass": "only a filter attenuates; record accelerations up to its cut-off",
    }
    typical = "1 to 20 ms: filters in the drive, buses, time stamps of different clocks"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        delay = float(values[0])
        change = partial(delayed_change, arm.t, delay=delay)
        own = change_where_known(arm, slice(joint, joint + 1), delay, change)
        return on_joint(own[:, 0], joint, arm.torque.shape[1])


def delayed_change(t: Array, torque: Array, delay: float) -> Array:
    """Return (τ(t − δ) − τ(t))/δ of torques (K, n), and its limit for small δ."""

    def at(times: Array) -> Array:
        return np.column_stack([np.interp(times, t, column) for column in torque.T])

    if abs(delay) < LEAST:
        return (at(t - LEAST) - at(t + LEAST)) / (2.0 * LEAST)
    return (at(t - delay) - torque) / delay


def change_where_known(
    arm: SegmentModel, joints: slice, past: float, change: Callable[[Array], Array]
) -> Array:
    """Return a change of the torque (K, n) of joints; that of friction only where it is known."""
    load = arm.load[:, joints]
    of_joints = change(arm.torque[:, joints] - load)
    return change(load) + where_known(of_joints, arm.t, arm.friction_known[:, joints], past)


def where_known(change: Array, t: Array, known: Mask, past: float) -> Array:
    """Return a change of torque (K, n), zero where it depends on unknown friction.

    That is within the memory ``past``, s (negative: the time to come), of rest, where friction has
    any value up to its level: a step there, wrong by one sample, exceeds what a delay causes.
    """
    step = (t[-1] - t[0]) / max(len(t) - 1, 1)
    first, last = t - max(past, 0.0) - step, t + max(-past, 0.0) + step
    result = change.copy()
    for j, own in enumerate(known.T):
        unknown = np.append(t[~own], np.inf)
        result[unknown[np.searchsorted(unknown, first)] <= last, j] = 0.0
    return result
