"""A torque sensor whose zero drifts."""

from __future__ import annotations

import numpy as np

from lieid_casadi.effects.arm_effect import ArmAlong, ArmEffect, Array, on_joint
from lieid_casadi.effects.effect import Coefficient, register


@register
class BiasDrift(ArmEffect):
    """A bias that grows with time; it does not carry over to another recording."""

    name = "bias_drift"
    formula = "r·(t − t̄)"
    coefficients = (Coefficient("r", "N·m/s"),)
    reach = "joint"

    def along(self, arm: ArmAlong, joint: int, values: Array) -> Array:
        """See the class."""
        drift = arm.t - arm.t.mean() if arm.fitted else np.zeros_like(arm.t)
        return on_joint(drift, joint, arm.torque.shape[1])
