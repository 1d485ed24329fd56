"""A base that does not stand level."""

from __future__ import annotations

import casadi as ca
import numpy as np

from lieid_casadi.effects.arm_effect import ArmAlong, ArmEffect, ArmNow, Array
from lieid_casadi.effects.effect import Coefficient, register

LEAST = 1e-4  # rad


@register
class BaseTilt(ArmEffect):
    """Gravity turned about the base's x axis, then about its y axis."""

    name = "base_tilt"
    formula = "gravity = R_y(β)·R_x(α)·g"
    coefficients = (Coefficient("alpha", "rad"), Coefficient("beta", "rad"))
    whole_arm = True

    def along(self, arm: ArmAlong, joint: int, values: Array) -> Array:
        """See the class."""
        return arm.gravity_by_axis() @ _changes(arm.gravity, values)

    def now(self, arm: ArmNow, joint: int, values: Array) -> ca.SX:
        """See the class."""
        return ca.horzcat(*(arm.gravity_torque(g) for g in _changes(arm.gravity, values).T))


def _changes(gravity: Array, values: Array) -> Array:
    """Return how gravity changes with each angle (3, 2)."""
    alpha, beta = (float(v) if abs(v) > LEAST else LEAST for v in values)
    now = abs(float(values[0])) > LEAST
    about_x = _turned(0, alpha) @ gravity
    before = about_x if now else gravity
    about_y = _turned(1, beta) @ before
    return np.column_stack([(about_x - gravity) / alpha, (about_y - before) / beta])


def _turned(axis: int, angle: float) -> Array:
    """Return the rotation about the x (0) or y (1) axis."""
    c, s = np.cos(angle), np.sin(angle)
    if axis == 0:
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
