"""The solids of an arm and their poses along a recording, for the view in three dimensions."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics.motion_symbols import Motion
from lieid_casadi.excitation.limits.link_geometry import capsules_of
from lieid_casadi.excitation.limits.symbolic_limits import link_poses
from lieid_casadi.expressions.frames import homogeneous
from lieid_casadi.recording import Recording
from lieid_casadi.robot import Robot
from lieid_casadi.workbench.computing.results import ArmMotion, ArmSolid

Array = NDArray[np.float64]
FRAMES_PER_SECOND = 20.0
MOST_FRAMES = 6000  # of a recording; longer ones get fewer per second


def arm_motion(robot: Robot, recording: Recording) -> ArmMotion:
    """Return the poses of the links at measured rows, at most 20 per second."""
    t = recording.t
    count = int(min(FRAMES_PER_SECOND * (t[-1] - t[0]) + 2, MOST_FRAMES, len(t)))
    rows = np.unique(np.searchsorted(t, np.linspace(t[0], t[-1], count)).clip(0, len(t) - 1))
    q = ca.SX.sym("q", robot.n)
    symbolic = [homogeneous(pose) for pose in link_poses(robot, Motion.of(q))]
    function = ca.Function("poses", [q], [ca.horzcat(*symbolic)])
    values = np.array(function.map(len(rows))(recording.q[rows].T).full())
    stacked = values.reshape(4, len(rows), robot.n + 1, 4)  # (row, frame, link, column)
    poses = np.ascontiguousarray(stacked.transpose(1, 2, 0, 3))
    tool = poses[:, -1] @ robot.tool
    points = np.concatenate([poses[:, :, :3, 3].reshape(-1, 3), tool[:, :3, 3]])
    low, high = points.min(axis=0), points.max(axis=0)
    return ArmMotion(t[rows], poses, 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))


def arm_solids(robot: Robot) -> tuple[ArmSolid, ...]:
    """Return the links as capsules, and a drum along the axis of each joint, which marks it."""
    capsules = capsules_of(robot)
    solids = [_solid(c.link, 0.5 * (c.start + c.end), c.end - c.start, c.radius) for c in capsules]
    size = float(np.median([c.radius for c in capsules])) if capsules else 0.05
    for link, joint in enumerate(robot.joints, start=1):
        direction = joint.axis[:3] if joint.revolute else joint.axis[3:]
        middle = np.cross(joint.axis[:3], joint.axis[3:])  # nearest the origin on the joint's axis
        solids.append(_solid(link, middle, 2.6 * size * direction, 0.6 * size, drum=True))
    return tuple(solids)


def _solid(
    link: int, middle: Array, along: Array, radius: float, *, drum: bool = False
) -> ArmSolid:
    """Return a solid whose axis has the direction and length of ``along``."""
    length = float(np.linalg.norm(along))
    axis = along / length if length > 0.0 else np.array([0.0, 1.0, 0.0])
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    third = np.cross(helper, axis) / np.linalg.norm(np.cross(helper, axis))
    rotation = np.column_stack([np.cross(axis, third), axis, third])
    return ArmSolid(link, drum, np.asarray(middle, dtype=float), rotation, length, float(radius))
