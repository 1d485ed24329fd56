"""Regressor of the rigid torque, exactly linear in the 10 n link parameters (Eq. 12)."""

from __future__ import annotations

import casadi as ca

from lieid_casadi.dynamics.lie import cross, hat, inverse_adjoint_times
from lieid_casadi.dynamics.motion import Motion, axes, relative_poses
from lieid_casadi.dynamics.recursion import BodyMotion, body_motions
from lieid_casadi.robot.robot import Robot


def regressor(robot: Robot, motion: Motion) -> ca.SX:
    """Return Y (n, 10 n), upper block triangular: joint j feels the links from j on.

    Row j of link i's block is z_{ij}ᵀ·W_i, with z_{ij} = joint j's unit twist seen in frame i
    and W_i (6, 10) the link's wrench per parameter. Projecting axes forward costs less than
    carrying ten wrenches backward.
    """
    blocks = ca.SX(robot.n, 10 * robot.n)
    bodies = body_motions(robot, motion)
    twists: list[ca.SX] = []
    for i, (g, xi) in enumerate(zip(relative_poses(robot, motion), axes(robot), strict=True)):
        twists = [inverse_adjoint_times(g, twist) for twist in twists] + [xi]
        wrench = LinkWrench(bodies[i])
        for j, twist in enumerate(twists):
            blocks[j, 10 * i : 10 * i + 10] = wrench.along(twist)
    return blocks


class LinkWrench:
    """The wrench of one link per parameter, split so that a projection costs few products."""

    def __init__(self, body: BodyMotion) -> None:
        omega, alpha = body.velocity[:3], body.angular_acceleration
        self.acceleration = body.acceleration
        self.turning = hat(alpha) + ca.mtimes(hat(omega), hat(omega))
        self.rotating = ca.horzcat(
            *(ca.mtimes(unit, alpha) + cross(omega, ca.mtimes(unit, omega)) for unit in UNITS)
        )

    def along(self, twist: ca.SX) -> ca.SX:
        """Return zᵀ·W (1, 10)."""
        z, v = twist[:3], twist[3:]
        return ca.horzcat(
            ca.mtimes(v.T, self.acceleration),
            (ca.mtimes(self.turning.T, v) + cross(self.acceleration, z)).T,
            ca.mtimes(z.T, self.rotating),
        )


def _unit(i: int, j: int) -> ca.SX:
    matrix = ca.SX(3, 3)
    matrix[i, j] = matrix[j, i] = 1
    return matrix


UNITS = tuple(_unit(i, j) for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))
