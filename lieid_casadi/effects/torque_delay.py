"""A torque that is recorded with a delay."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca
import numpy as np

from lieid_casadi.effects.arm_effect import ArmEffect, Array, InstantModel, SegmentModel, on_joint
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register

LEAST = 1e-3  # s; below it the column is the derivative, not the difference quotient


@register
class TorqueDelay(ArmEffect):
    """The torque is recorded late: τ_measured(t) = τ(t − δ), δ in s.

    Revealed by fast changes of torque. Confused with viscous friction and armature; a delay below
    one sampling interval cannot be distinguished from an error of differentiation. Exported code
    computes the torque at the instant, without the delay.
    """

    name = "torque_delay"
    formula = "τ_measured(t) = τ(t − δ)"
    coefficients = (Coefficient("delta", "s", meaning="delay", resolved_by="sample_time"),)
    reach = "joint"
    needs_past = True
    export_note = "omitted: the torque is that of the instant, without the delay of its measurement"
    trial_values = ((-0.02,), (-0.005,), (0.005,), (0.01,), (0.02,), (0.04,), (0.08,))
    revealed_by = "fast changes of torque: high accelerations, reversals, rates above 100 Hz"
    confused_with: ClassVar = {
        "viscous": "a delayed inertia torque resembles damping; vary the frequency",
        "armature": "a delayed damping torque resembles inertia; vary the frequency",
    }
    typical = "1 to 20 ms: filters in the drive, buses, time stamps of different clocks"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        """Return the columns of the formula."""
        delay = float(values[0])
        torque = arm.torque[:, joint]
        if abs(delay) < LEAST:
            late, early = (np.interp(arm.t + s * LEAST, arm.t, torque) for s in (-1.0, 1.0))
            change = (late - early) / (2.0 * LEAST)
        else:
            change = (np.interp(arm.t - delay, arm.t, torque) - torque) / delay
        return on_joint(change, joint, arm.torque.shape[1])

    def instant_columns(self, arm: InstantModel, joint: int, values: ca.SX) -> ca.SX:
        """Return zeros: a controller needs the torque at the instant."""
        return ca.SX(arm.load.shape[0], 1)
