"""A base that does not stand level."""

from __future__ import annotations

import numpy as np

from lieid_casadi.effects.arm_effect import ArmAlong, ArmEffect, Array
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
        alpha, beta = (float(v) if abs(v) > LEAST else LEAST for v in values)
        now = abs(float(values[0])) > LEAST
        about_x = _turned(0, alpha) @ arm.gravity
        about_y = _turned(1, beta) @ (about_x if now else arm.gravity)
        changes = [
            (about_x - arm.gravity) / alpha,
            (about_y - (about_x if now else arm.gravity)) / beta,
        ]
        return arm.gravity_by_axis() @ np.column_stack(changes)


def _turned(axis: int, angle: float) -> Array:
    """Return the rotation about the x (0) or y (1) axis."""
    c, s = np.cos(angle), np.sin(angle)
    if axis == 0:
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
