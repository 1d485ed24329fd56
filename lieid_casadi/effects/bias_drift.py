"""A torque sensor whose zero drifts."""

from __future__ import annotations

import casadi as ca
import numpy as np

from lieid_casadi.effects.arm_effect import ArmAlong, ArmEffect, ArmNow, Array, on_joint
from lieid_casadi.effects.effect import Coefficient, register


@register
class BiasDrift(ArmEffect):
    """A bias that grows with time; it does not carry over to another recording."""

    name = "bias_drift"
    formula = "r·(t − t̄)"
    coefficients = (Coefficient("r", "N·m/s"),)
    reach = "joint"
    in_code = "left out: it belongs to the recordings of the fit and does not carry over"

    def along(self, arm: ArmAlong, joint: int, values: Array) -> Array:
        """See the class."""
        drift = arm.t - arm.t.mean() if arm.fitted else np.zeros_like(arm.t)
        return on_joint(drift, joint, arm.torque.shape[1])

    def now(self, arm: ArmNow, joint: int, values: Array) -> ca.SX:
        """Return zeros, as along any recording that was not fitted."""
        return ca.SX(arm.load.shape[0], 1)
