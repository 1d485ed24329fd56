"""Play between motor and link."""

import casadi as ca
import numpy as np

from lieid_casadi.effects.arm_effect import ArmEffect, Array, InstantModel, SegmentModel, lag_torque
from lieid_casadi.effects.effect import Coefficient, Shape
from lieid_casadi.effects.registry import register

LEAST = 1e-3  # rad, smallest play of the difference quotient
LEAST_INERTIA = 0.05  # of the median along the motion, if a fit gives less or a negative one


@register
class Backlash(ArmEffect):
    """The link moves freely within a play b of the transmission: q_link = q − g, |g| ≤ b/2.

    q is measured at the motor. While the motor drives the link, g = ±b/2 with the sign of the
    link-side torque τ_load. When τ_load changes its sign, the link flies freely, M_ii·g̈ = τ_load,
    until it hits the other side of the play, where the collision is inelastic. w in rad is the play
    that follows from the time of the crossing, b the one that follows from its torque; they agree
    for a rigid transmission. Of position-controlled drives.
    """

    name = "backlash"
    finding = ("The transmission of {joints} has play",)
    change = ("The play of {joints} has {increased}",)
    formula = "q_link = q − g; g = b/2·sgn(τ_load), after a change of sign M_ii·g̈ = τ_load"
    coefficients = (Coefficient("b", "rad", lower=0.0, limit=0.3, meaning="play of the gear"),)
    shapes = (
        Shape("w", "rad", 0.015, 0.002, 0.12, meaning="play that the time of crossing shows"),
    )  # fmt: skip
    commanded = True
    needs_past = True
    export_note = "the time in which the play is crossed is neglected"
    revealed_by = "loads that change their sign often: fast motion, gravity loads of both signs"
    confused_with = {
        "encoder_offset": "the same while the load has one sign; use both",
        "joint_elasticity": "elasticity grows with the load; vary it",
        "coulomb": "similar where the load changes its sign with the velocity",
    }
    typical = "0.5 to 1° (0.009 to 0.017 rad) of hobby servos"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        play = max(float(values[1]), LEAST)
        change = lag_torque(arm, joint, motor_in_play(arm, joint, play))
        return np.asarray(change[:, :, None] / play)

    def instant_columns(self, arm: InstantModel, joint: int, values: ca.SX) -> ca.SX:
        """Return the columns of the formula without the crossing."""
        play = ca.fmax(values[0], LEAST)
        offset = ca.SX(arm.load.shape[0], 1)
        offset[joint] = -0.5 * play * ca.sign(arm.load[joint])
        return (arm.rigid_beside(offset) - arm.load) / play


def motor_in_play(arm: SegmentModel, joint: int, play: float) -> Array:
    """Return the position (K,) of a motor relative to its link along a segment, rad."""
    return place_in_play(arm.load[:, joint] / _inertia(arm, joint), arm.t, play)


def place_in_play(acceleration: Array, t: Array, play: float) -> Array:
    """Return the position (K,) of a motor relative to its link, rad, in −play/2 … play/2."""
    half, count = 0.5 * play, len(t)
    steps = np.diff(t)
    speed = np.concatenate([[0.0], np.cumsum(0.5 * steps * (acceleration[1:] + acceleration[:-1]))])
    way = np.concatenate([[0.0], np.cumsum(0.5 * steps * (speed[1:] + speed[:-1]))])
    pulling = {side: np.flatnonzero(side * acceleration < 0.0) for side in (-1.0, 1.0)}
    place = np.empty(count)
    k, side = 0, -1.0 if acceleration[0] < 0.0 else 1.0
    while k < count:
        later = pulling[side][np.searchsorted(pulling[side], k) :]
        start = int(later[0]) if len(later) else count
        place[k:start] = side * half
        if start == count:
            break
        free = side * half + way[start:] - way[start] - speed[start] * (t[start:] - t[start])
        outside = np.abs(free) > half
        outside[0] = False
        length = int(np.argmax(outside)) if outside.any() else len(free)
        place[start : start + length] = free[:length]
        k = start + length
        if k < count:
            side = 1.0 if free[length] > 0.0 else -1.0
    return place


def _inertia(arm: SegmentModel, joint: int) -> Array:
    """Return the inertia (K,) that the joint moves while the other joints follow their motion."""
    q, rest = arm.motion[0], np.zeros_like(arm.motion[0])
    unit = rest.copy()
    unit[:, joint] = 1.0
    inertia = (arm.rigid(q, rest, unit) - arm.rigid(q, rest, rest))[:, joint]
    typical = float(np.median(np.abs(inertia)))
    return np.maximum(inertia, max(LEAST_INERTIA * typical, np.finfo(float).tiny))
