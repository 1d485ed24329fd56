"""A robot as a model of Pinocchio, which shares nothing with the symbolic dynamics."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RobotError
from lieid_casadi.robot.robot import Robot

TOOL_FRAME = "tool"


def build_pinocchio(
    robot: Robot, parameters: ArrayLike | None = None, *, gravity: ArrayLike | None = None
) -> Any:
    """Return a ``pinocchio.Model`` of the arm; its joint coordinates are the robot's.

    Pinocchio rotates a link about the origin of its joint frame, but the origin of a link frame may
    be off the joint axis. The joint frame is placed at the nearest point of the axis, with the same
    orientation, and inertias are transformed. Link parameters (10 n,), about the link
    frames' origins, and gravity (3,) in the base frame are the robot's own by default.

    RobotError: parameters of the wrong size, or none at all.
    """
    import pinocchio as pin

    links = _links(robot, parameters)
    model = pin.Model()
    model.name = robot.name
    model.gravity = pin.Motion(
        np.asarray(robot.gravity if gravity is None else gravity, dtype=float), np.zeros(3)
    )
    parent, parent_pose = 0, pin.SE3.Identity()
    for joint, link in zip(robot.joints, links, strict=True):
        to_axis = point_on_axis(joint.axis)
        home = pin.SE3(joint.home[:3, :3], joint.home[:3, 3] + joint.home[:3, :3] @ to_axis)
        kind = (
            pin.JointModelRevoluteUnaligned if joint.revolute else pin.JointModelPrismaticUnaligned
        )
        axis = joint.axis[:3] if joint.revolute else joint.axis[3:]
        parent = model.addJoint(parent, kind(axis), parent_pose.actInv(home), joint.name)
        offset = pin.SE3(np.eye(3), -to_axis)
        model.appendBodyToJoint(parent, _inertia(link), offset)
        parent_pose = home
    tool = pin.SE3(robot.tool[:3, :3], robot.tool[:3, 3] + offset.translation)
    model.addFrame(pin.Frame(TOOL_FRAME, parent, 0, tool, pin.FrameType.OP_FRAME))
    return model


def _links(robot: Robot, parameters: ArrayLike | None) -> Array:
    if parameters is None:
        return robot.link_parameters.reshape(-1, 10)
    given = np.asarray(parameters, dtype=float)
    if given.shape != (10 * robot.n,):
        raise RobotError(
            f"robot {robot.name!r}: link parameters of shape {given.shape}, "
            f"expected ({10 * robot.n},)"
        )
    return given.reshape(-1, 10)


def point_on_axis(axis: Array) -> Array:
    """Return the point (3,) of a joint's axis nearest to the link frame's origin."""
    return np.cross(axis[:3], axis[3:])


def _inertia(link: Array) -> Any:
    import pinocchio as pin

    if link[0] == 0.0:  # a pure inertia has no centre of mass
        return pin.Inertia(0.0, np.zeros(3), pin.Symmetric3(*link[4:]))
    return pin.Inertia.FromDynamicParameters(link)
