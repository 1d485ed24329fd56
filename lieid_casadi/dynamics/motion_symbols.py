"""Symbols of a motion, and the relative poses they give."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from lieid_casadi.dynamics.lie import Pose, constant, exp, pose
from lieid_casadi.robot.geometry import relative
from lieid_casadi.robot.robot import Robot


@dataclass(frozen=True)
class Motion:
    """Symbols q, q̇, q̈ (n,) with the sines and cosines of q.

    Sines and cosines are separate symbols because generated code computes them for many samples at
    once. `of` substitutes ``ca.sin(q)`` and ``ca.cos(q)``.
    """

    q: ca.SX
    sin: ca.SX
    cos: ca.SX
    dq: ca.SX
    ddq: ca.SX

    @classmethod
    def symbols(cls, n: int) -> Motion:
        """Return fresh symbols, sines and cosines being symbols too."""
        return cls(*(ca.SX.sym(name, n) for name in ("q", "sin", "cos", "dq", "ddq")))

    @classmethod
    def of(cls, q: ca.SX, dq: ca.SX | None = None, ddq: ca.SX | None = None) -> Motion:
        """Return the motion of given expressions.

        ``q`` (n,): rad (m for a prismatic joint); ``dq``, ``ddq`` (n,): structurally zero if left
        out.
        """
        zero = ca.SX(q.shape[0], 1)
        dq, ddq = (zero if rate is None else rate for rate in (dq, ddq))
        return cls(q, ca.sin(q), ca.cos(q), dq, ddq)


def relative_poses(robot: Robot, motion: Motion) -> list[Pose]:
    """Return g_{i-1,i}(q): each link frame in the frame of the link before (base first)."""
    poses, before = [], np.eye(4)
    for i, joint in enumerate(robot.joints):
        home = pose(relative(before, joint.home))
        poses.append(home @ exp(joint.axis, motion.q[i], motion.sin[i], motion.cos[i]))
        before = joint.home
    return poses


def axes(robot: Robot) -> list[ca.SX]:
    """Return each joint's unit twist ξ_i (6,) in its link frame."""
    return [constant(joint.axis) for joint in robot.joints]


def tool_pose(robot: Robot) -> Pose:
    """Return the tool in the last link's frame."""
    return pose(robot.tool)
