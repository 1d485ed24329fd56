"""Position errors to which a controller does not react."""

import numpy as np

from lieid_casadi.effects.arm_effect import ArmEffect, Array, SegmentModel, on_joint
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register

LEAST = 1e-5  # rad; below it the column is its limit, the sign of the error


@register
class Deadband(ArmEffect):
    """A controller delivers no torque for errors below d: the law exceeds it by K·clip(e, ±d).

    e = q_cmd − q and d in rad, K the stiffness of the drive's law. Of position-controlled drives.
    Exported C computes the torque that the drives deliver.
    """

    name = "deadband"
    finding = ("The controller of {joints} does not react to small errors",)
    change = ("The dead band of {joints} has {increased}",)
    formula = "K·clip(q_cmd − q, ±d)"
    coefficients = (Coefficient("d", "rad", lower=0.0, meaning="half width of the dead band"),)
    commanded = True
    like_uncertain_friction = ("late", "early", "rest")  # errors are small near reversals
    reach = "joint"
    export_note = "omitted: the torque is that which the drives deliver"
    revealed_by = "position errors of both signs: slow motion, loads of both signs"
    confused_with = {
        "coulomb": "a dead band follows the sign of the error, friction that of the velocity",
        "load_friction": "both follow the load; vary its size",
    }
    typical = "1 to 3 counts of 4096 (0.0015 to 0.005 rad) of hobby servos"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        assert arm.command is not None  # checked before identification
        assert arm.drives is not None
        band = max(float(values[0]), LEAST)
        error = arm.command[:, joint] - arm.motion[0][:, joint]
        lost = arm.drives[joint].stiffness * np.clip(error, -band, band)
        return on_joint(lost / band, joint, arm.load.shape[1])
