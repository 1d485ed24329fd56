"""Drift of the zero of a torque sensor."""

import numpy as np

from lieid_casadi.effects.arm_effect import ArmEffect, Array, SegmentModel, on_joint
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register


@register
class BiasDrift(ArmEffect):
    """A bias that grows with time: τ = r·(t − t̄), r in N·m/s, t̄ the mean time of the recording.

    It does not carry over to another recording: predictions of other recordings and exported code
    omit it. A model has one rate r for all recordings of its fit; the diagnosis states other rates
    in each recording as a difference between the recordings.
    """

    name = "bias_drift"
    finding = ("The torque of {joints} drifts upwards", "The torque of {joints} drifts downwards")
    formula = "r·(t − t̄)"
    coefficients = (Coefficient("r", "N·m/s", meaning="drift rate"),)
    reach = "joint"
    per_recording = True
    on_torque_signal = True
    linear = True
    revealed_by = "the same motion repeated over several minutes"
    confused_with = {
        "warm_up": "only warm-up changes sign with the velocity; drive both directions",
        "offset": "similar in short recordings; record longer",
    }
    typical = "0.1 to 1 % of a torque sensor's range per hour"
    export_note = "omitted: it belongs to the recordings of the fit and does not carry over"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        drift = arm.t - arm.t.mean() if arm.fitted else np.zeros_like(arm.t)
        return on_joint(drift, joint, arm.torque.shape[1])
