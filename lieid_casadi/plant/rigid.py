"""The rigid body of the plant: a Pinocchio model built by hand from screws and home poses."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.errors import RobotError
from lieid_casadi.robot import Robot

Array = NDArray[np.float64]

TOOL_FRAME = "tool"


def build_pinocchio(
    robot: Robot, parameters: ArrayLike | None = None, *, gravity: ArrayLike | None = None
) -> Any:
    """Return a ``pinocchio.Model`` of the arm; its joint coordinates are the robot's.

    Pinocchio turns a link about its joint frame's origin. A link frame may lie off the joint's
    axis, so the joint frame is put where the axis is nearest to it, with the same orientation,
    and inertias are carried over.

    Parameters
    ----------
    parameters : (10 n,), optional
        Link parameters about the link frames' origins; without them the robot's own.
    gravity : (3,), optional
        In the base frame, m/s²; without it the robot's own.

    Raises
    ------
    RobotError
        Parameters of the wrong size, or none where the robot states none.
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
        to_axis = _point_on_axis(joint.axis)
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


def _point_on_axis(axis: Array) -> Array:
    """Return the point (3,) of a joint's axis nearest to the link frame's origin."""
    return np.cross(axis[:3], axis[3:])


def _inertia(link: Array) -> Any:
    import pinocchio as pin

    if link[0] == 0.0:  # no centre of mass to divide by: a pure inertia
        return pin.Inertia(0.0, np.zeros(3), pin.Symmetric3(*link[4:]))
    return pin.Inertia.FromDynamicParameters(link)


def rigid_torques(model: Any, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the rigid torques (N, n) of Pinocchio along a path (N, n) each.

    Parameters
    ----------
    model : pinocchio.Model
    q, dq, ddq : (N, n)
        rad, rad/s, rad/s².
    """
    import pinocchio as pin

    data = model.createData()
    tau = np.empty_like(q)
    for k in range(q.shape[0]):
        tau[k] = pin.rnea(model, data, q[k], dq[k], ddq[k])
    return tau


def wrench_torque(model: Any, data: Any, q: Array, wrench: Array) -> Array:
    """Return Jᵀ·F (n,) of a wrench [m; f] that the tool exerts at its origin, in base axes.

    Parameters
    ----------
    model : pinocchio.Model
    data : pinocchio.Data
    q : (n,)
        rad.
    wrench : (6,)
        [m; f], N·m and N, base axes.
    """
    import pinocchio as pin

    frame = model.getFrameId(TOOL_FRAME)
    jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    torque: Array = jacobian.T @ np.concatenate([wrench[3:], wrench[:3]])
    return torque
