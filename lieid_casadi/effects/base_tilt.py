"""Tilt of the base against gravity."""

import casadi as ca
import numpy as np

from lieid_casadi.effects.arm_effect import ArmEffect, Array, InstantModel, SegmentModel
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register

LEAST = 1e-4  # rad


@register
class BaseTilt(ArmEffect):
    """Gravity rotated about the base's x axis, then about its y axis: R_y(β)·R_x(α)·g.

    α and β in rad.
    """

    name = "base_tilt"
    finding = ("The base is tilted",)
    change = ("The base has tilted",)
    formula = "gravity = R_y(β)·R_x(α)·g"
    coefficients = (
        Coefficient("alpha", "rad", limit=0.8, meaning="tilt about the base's x axis"),
        Coefficient("beta", "rad", limit=0.8, meaning="tilt about the base's y axis"),
    )
    whole_arm = True
    on_measurement = False
    revealed_by = "gravity torque in poses spread over the workspace, above all on the first joint"
    confused_with = {
        "encoder_offset": "both turn gravity; a tilt acts on all joints",
        "offset": "similar on a vertical first joint over a small range; use the whole range",
    }
    typical = "0.1 to 2°"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        changes = ca.evalf(_changes(ca.SX(ca.DM(arm.gravity)), ca.SX(ca.DM(values))))
        return np.asarray(arm.gravity_by_axis() @ changes.full())

    def instant_columns(self, arm: InstantModel, joint: int, values: ca.SX) -> ca.SX:
        changes = ca.horzsplit(_changes(arm.gravity, values))
        return ca.horzcat(*(arm.gravity_torque(change) for change in changes))


def _changes(gravity: ca.SX, values: ca.SX) -> ca.SX:
    """Return the change of gravity per angle (3, 2), as a difference quotient."""
    alpha, beta = (ca.if_else(ca.fabs(v) > LEAST, v, LEAST) for v in ca.vertsplit(values))
    about_x = _rotated_about_x(gravity, alpha)
    before = ca.if_else(ca.fabs(values[0]) > LEAST, about_x, gravity)
    about_y = _rotated_about_y(before, beta)
    return ca.horzcat((about_x - gravity) / alpha, (about_y - before) / beta)


def _rotated_about_x(v: ca.SX, angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(v[0], c * v[1] - s * v[2], s * v[1] + c * v[2])


def _rotated_about_y(v: ca.SX, angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(c * v[0] + s * v[2], v[1], c * v[2] - s * v[0])
