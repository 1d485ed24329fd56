"""A joint that winds up under load."""

from __future__ import annotations

import numpy as np

from lieid_casadi.effects.arm_effect import ArmAlong, ArmEffect, Array
from lieid_casadi.effects.effect import Coefficient, register

LEAST = 1e-4  # rad of winding at the largest load: below it a difference stands for a derivative


@register
class JointElasticity(ArmEffect):
    """The link's angle is the measured one of the motor less τ/K, τ the link-side torque."""

    name = "joint_elasticity"
    formula = "q_link = q − c·τ_load, c = 1/K"
    coefficients = (Coefficient("c", "rad/(N·m)", lower=0.0),)
    starts = ((1e-4,), (3e-4,), (1e-3,), (3e-3,))  # geared drives have 1e-5 to 1e-3

    def along(self, arm: ArmAlong, joint: int, values: Array) -> Array:
        """See the class."""
        load = arm.smooth(arm.load[:, joint])
        largest = float(np.abs(load).max(initial=0.0))
        if largest == 0.0:
            return np.zeros((*arm.load.shape, 1))
        step = max(float(values[0]), LEAST / largest)
        rate = np.gradient(load, arm.t)
        moved = [x.copy() for x in arm.motion]
        for signal, wound in zip(moved, (load, rate, np.gradient(rate, arm.t)), strict=True):
            signal[:, joint] -= step * wound
        change = arm.rigid(moved[0], moved[1], moved[2]) - arm.load
        return change[:, :, None] / step
