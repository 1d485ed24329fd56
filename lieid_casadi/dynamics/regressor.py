"""Regressor of the rigid torque, exactly linear in the 10 n link parameters (Eq. 12)."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from lieid_casadi.dynamics.lie import Motion, axes, cross, inverse_adjoint_times, relative_poses
from lieid_casadi.dynamics.recursion import (
    LinkAcceleration,
    ReferenceMotion,
    inertia_moments,
    link_accelerations,
)
from lieid_casadi.robot.robot import Robot


def regressor(robot: Robot, motion: Motion) -> ca.SX:
    """Return Y (n, 10 n), upper block triangular: the links from j on act on joint j."""
    return _projected(robot, motion, link_accelerations(robot, motion))


def slotine_li_regressor(robot: Robot, motion: Motion, reference: ReferenceMotion) -> ca.SX:
    """Return Y(q, q̇, q̇_r, q̈_r) (n, 10 n) with Y·π = M·q̈_r + C·q̇_r + G, Ṁ − 2C skew-symmetric.

    For adaptive control: Slotine, Li, "On the adaptive control of robot manipulators", IJRR 1987.
    """
    return _projected(robot, motion, link_accelerations(robot, motion, reference=reference))


def _projected(robot: Robot, motion: Motion, bodies: Sequence[LinkAcceleration]) -> ca.SX:
    """Return the torque of each link parameter, given the links' accelerations.

    Row j of link i's block is z_{ij}ᵀ·W_i, with z_{ij} = joint j's unit twist in frame i
    and W_i (6, 10) the link's wrench per parameter. Projecting axes forward costs less than
    propagating ten wrenches backward.
    """
    blocks = ca.SX(robot.n, 10 * robot.n)
    twists: list[ca.SX] = []
    for i, (g, xi) in enumerate(zip(relative_poses(robot, motion), axes(robot), strict=True)):
        twists = [inverse_adjoint_times(g, twist) for twist in twists] + [xi]
        acceleration, gradient = bodies[i].acceleration, bodies[i].gradient
        rotating = inertia_moments(bodies[i])
        for j, twist in enumerate(twists):
            z, v = twist[:3], twist[3:]
            blocks[j, 10 * i : 10 * i + 10] = ca.horzcat(
                ca.mtimes(v.T, acceleration),
                (ca.mtimes(gradient.T, v) + cross(acceleration, z)).T,
                ca.mtimes(z.T, rotating),
            )
    return blocks
