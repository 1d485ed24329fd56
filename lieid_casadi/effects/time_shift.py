"""Torque and motion that are recorded by different clocks."""

from functools import partial

from lieid_casadi.effects.arm_effect import ArmEffect, Array, SegmentModel
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register
from lieid_casadi.effects.torque_delay import change_where_known, delayed_change


@register
class TimeShift(ArmEffect):
    """The torques of all joints are recorded late by the same time: τ_measured(t) = τ(t − δ).

    δ in s. It has one cause for the whole arm: the filter of the torque signals, a bus, or time
    stamps of different clocks. Confused with `torque_lowpass/common`. Exported code computes the
    torque at the instant, without the shift.
    """

    name = "time_shift"
    finding = (
        "The torques of all joints lag behind the positions",
        "The torques of all joints lead the positions",
    )
    formula = "τ_measured(t) = τ(t − δ) on every joint"
    coefficients = (Coefficient("delta", "s", limit=0.5, meaning="shift", resolved_by="lead"),)
    whole_arm = True
    needs_past = True
    on_torque_signal = True
    like_uncertain_friction = ("late",)
    export_note = "omitted: the torque is that of the instant, without the shift of its measurement"
    trial_values = ((-0.02,), (-0.005,), (0.005,), (0.01,), (0.02,), (0.04,), (0.08,))
    revealed_by = "fast changes of torque: high accelerations, reversals, rates above 100 Hz"
    confused_with = {
        "torque_lowpass": "only a filter attenuates; record accelerations up to its cut-off",
        "torque_delay": "a shift of the whole arm is one delay for all joints",
    }
    typical = "1 to 20 ms: filters of the controller, buses, time stamps of different clocks"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        delay = float(values[0])
        change = partial(delayed_change, arm.t, delay=delay)
        return change_where_known(arm, slice(None), delay, change)[:, :, None]
