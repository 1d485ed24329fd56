"""Drift of the zero of a torque sensor."""

import numpy as np

from lieid_casadi.effects.arm_effect import ArmEffect, Array, SegmentModel
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register
from lieid_casadi.errors import EffectError


@register
class BiasDrift(ArmEffect):
    """A bias that grows with time: τ = r·(t − t̄), r in N·m/s, t̄ the mean time of the recording.

    It does not carry over to other recordings: predictions of these and exported code omit it. The
    option is the number of recordings of the fit, each with its own rate r1, r2, … in place of one.
    """

    name = "bias_drift"
    finding = ("The torque of {joints} drifts",)
    formula = "r·(t − t̄)"
    coefficients: tuple[Coefficient, ...] = (Coefficient("r", "N·m/s", meaning="drift rate"),)
    options = {"2": "another rate in each of two recordings, r1 and r2; or of any number of them"}
    free_options = True
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

    def __init__(self, *, option: str = "") -> None:
        self.option = option
        if option and not (option.isdecimal() and 0 < int(option) < 1000):
            raise EffectError(f"{self.name}/{option}: expected a number of recordings")
        if option:
            self.coefficients = tuple(
                Coefficient(f"r{k}", "N·m/s", meaning=f"drift rate in recording {k}")
                for k in range(1, int(option) + 1)
            )

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        columns = np.zeros((*arm.torque.shape, len(self.coefficients)))
        if arm.recording is not None:
            column = arm.recording if self.option else 0
            columns[:, joint, column : column + 1] = (arm.t - arm.t.mean())[:, None]
        return columns
