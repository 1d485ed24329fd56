"""Kinematics of the tool and of link frames as CasADi functions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.lie import Motion, Pose
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.torque import named_function
from lieid_casadi.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Frame:
    """The tool of ``robot``: an arm of so many ``joints`` up to the link with the frame."""

    robot: Robot
    joints: int

    @cached_property
    def forward_kinematics(self) -> ca.Function:
        """``q -> T`` (4, 4): homogeneous pose of the frame in the base frame."""
        q = ca.SX.sym("q", self.joints)
        pose = recursion.tool_in_base(self.robot, Motion.of(q[: self.robot.n]))
        return named_function("forward_kinematics", {"q": q}, {"T": homogeneous(pose)})

    @cached_property
    def jacobian(self) -> ca.Function:
        """``q -> J`` (6, n): twist [ω; v] of the frame's origin is J·dq, in axes of the base."""
        q = ca.SX.sym("q", self.joints)
        moving = closed_form.jacobian(self.robot, Motion.of(q[: self.robot.n]))
        still = ca.SX(6, self.joints - self.robot.n)
        matrix = ca.horzcat(moving, still)
        return named_function("jacobian", {"q": q}, {"J": matrix})


def frame_of(robot: Robot, name: str) -> Frame:
    """Return the kinematics of ``tool``, ``link1`` … ``linkn``, or a joint's or link's name."""
    if name == "tool":
        return Frame(robot, robot.n)
    for i, joint in enumerate(robot.joints):
        if name in (f"link{i + 1}", joint.name, joint.link_name):
            part = replace(robot, joints=robot.joints[: i + 1], tool=np.eye(4), source=None)
            return Frame(part, robot.n)
    names = [joint.link_name or joint.name for joint in robot.joints]
    raise ModelError(
        f"robot {robot.name!r} has no frame {name!r}; expected tool, link1 … link{robot.n}, "
        f"or one of {', '.join(names)}"
    )


def homogeneous(pose: Pose) -> ca.SX:
    """Return a pose as a matrix (4, 4)."""
    top = ca.horzcat(pose.rotation, pose.translation)
    return ca.densify(ca.vertcat(top, ca.SX(ca.DM([[0.0, 0.0, 0.0, 1.0]]))))
