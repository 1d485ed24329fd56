"""Commands that reach the drive late."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca
import numpy as np

from lieid_casadi.effects.arm_effect import ArmEffect, Array, InstantModel, SegmentModel, on_joint
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register

LEAST = 1e-3  # s; below it the column is the derivative, not the difference quotient


@register
class CommandDelay(ArmEffect):
    """A drive follows an older command: q_cmd(t − δ) in its control law, δ in s.

    The law of the recorded command then exceeds the delivered torque by the difference. Commands
    that are held from row to row are late by half of that interval, which δ contains. Of
    position-controlled drives. Revealed by commands that change quickly. Confused with viscous
    friction; a delay below one sampling interval is not resolved. Exported C computes the torque
    that the drives deliver.
    """

    name = "command_delay"
    finding: ClassVar = ("The commands of {joints} act late",)
    change: ClassVar = (
        "The delay of the commands of {joints} has increased",
        "The delay of the commands of {joints} has decreased",
    )
    formula = "law(q_cmd(t) − q) − law(q_cmd(t − δ) − q)"
    coefficients = (
        Coefficient("delta", "s", lower=0.0, meaning="delay", resolved_by="sample_time"),
    )
    commanded = True
    reach = "joint"
    needs_past = True
    export_note = "omitted: the torque is that which the drives deliver"
    revealed_by = "commands that change quickly, of one direction and the other"
    confused_with: ClassVar = {
        "viscous": "a delay acts with the velocity of the command; vary accelerations",
        "back_emf": "as viscous",
        "deadband": "a delay vanishes when the command rests",
    }
    typical = "10 to 100 ms of teleoperation: bus, host, interpolation in the servo"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        """Return the columns of the formula."""
        assert arm.command is not None  # checked before identification
        assert arm.drives is not None
        q, dq, law = arm.motion[0][:, joint], arm.motion[1][:, joint], arm.drives[joint]
        command, delay = arm.command[:, joint], max(float(values[0]), LEAST)
        late = np.interp(arm.t - delay, arm.t, command)
        change = law.torque(command - q, dq) - law.torque(late - q, dq)
        return on_joint(change / delay, joint, arm.load.shape[1])

    def instant_columns(self, arm: InstantModel, joint: int, values: ca.SX) -> ca.SX:
        """Return zeros: the torque is that which the drives deliver."""
        return ca.SX(arm.load.shape[0], 1)
