"""Tilt of the base against gravity."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca
import numpy as np

from lieid_casadi.effects.arm_effect import ArmEffect, Array, InstantModel, SegmentModel
from lieid_casadi.effects.effect import Coefficient, register

LEAST = 1e-4  # rad


@register
class BaseTilt(ArmEffect):
    """Gravity rotated about the base's x axis, then about its y axis: R_y(β)·R_x(α)·g.

    α and β in rad. Revealed by gravity torque in poses spread over the workspace, above all on
    a vertical first joint. Confused with link parameters and with `encoder_offset`.
    """

    name = "base_tilt"
    formula = "gravity = R_y(β)·R_x(α)·g"
    coefficients = (
        Coefficient("alpha", "rad", meaning="tilt about the base's x axis"),
        Coefficient("beta", "rad", meaning="tilt about the base's y axis"),
    )
    whole_arm = True
    revealed_by = "gravity torque in poses spread over the workspace, above all on the first joint"
    confused_with: ClassVar = {
        "encoder_offset": "both turn gravity; a tilt acts on all joints",
        "offset": "on a vertical first joint over a small range; turn it through its whole range",
    }
    typical = "0.1 to 2°"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        """Return the columns of the formula."""
        return arm.gravity_by_axis() @ _changes(arm.gravity, values)

    def instant_columns(self, arm: InstantModel, joint: int, values: Array) -> ca.SX:
        """Return the columns of the formula."""
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
