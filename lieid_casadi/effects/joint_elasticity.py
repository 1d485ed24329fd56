"""Elasticity between motor and link."""

import numpy as np

from lieid_casadi.effects.arm_effect import ArmEffect, Array, SegmentModel, lag_torque
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register

LEAST = 1e-4  # rad of deflection at the largest load; smallest step of the difference quotient


@register
class JointElasticity(ArmEffect):
    """The link angle lags behind the measured motor angle: q_link = q − c·τ_load, c = 1/K.

    The compliance c in rad/(N·m) is not negative; τ_load is the link-side torque in N·m. Other
    joints are affected through the dynamics.
    """

    name = "joint_elasticity"
    finding = ("The transmission of {joints} is elastic",)
    change = (
        "The transmission of {joints} has become softer",
        "The transmission of {joints} has become stiffer",
    )
    formula = "q_link = q − c·τ_load, c = 1/K"
    coefficients = (Coefficient("c", "rad/(N·m)", lower=0.0, limit=0.2, meaning="compliance 1/K"),)
    needs_past = True
    trial_values = ((1e-4,), (3e-4,), (1e-3,), (3e-3,))
    revealed_by = "high accelerations with a large inertia behind the joint, and large loads"
    confused_with = {
        "torque_delay": "both shift the torque in time; vary the frequency",
        "armature": "both grow with acceleration; elasticity also moves other joints",
        "encoder_offset": "under a constant load the deflection is an offset; vary the load",
    }
    typical = "1e-5 to 1e-3 rad/(N·m) with geared drives"
    references = (
        "Spong, J. Dyn. Syst. Meas. Control 109(4), 1987",
        "De Luca, Book, Robots with Flexible Elements, Springer Handbook of Robotics",
    )

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        load = arm.smooth_load[:, joint]
        largest = float(np.abs(load).max(initial=0.0))
        if largest == 0.0:
            return np.zeros((*arm.load.shape, 1))
        step = max(float(values[0]), LEAST / largest)
        return lag_torque(arm, joint, load, step)[:, :, None] / step
