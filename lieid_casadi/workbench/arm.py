"""The arm in three dimensions: meshes or capsules of its links, and their poses over time."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.excitation.limits import link_poses
from lieid_casadi.excitation.links import UrdfModel, capsules_of, package_folders
from lieid_casadi.expressions.symbolic import homogeneous
from lieid_casadi.robot import Robot

FRAMES_PER_SECOND = 20.0
AROUND = 24  # edges of a circle
MOST_FRAMES = 6000  # of a recording; longer ones get fewer per second


@dataclass(frozen=True, eq=False)
class ArmMesh:
    """Surface of a link in its frame, or drum that marks its joint: a binary STL file, m."""

    link: int
    stl: bytes
    drum: bool = False


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """Poses of the base and the links in the base frame, and the box around all positions, m."""

    times: Array  # (F,) on the motion's own clock, s
    poses: Array  # (F, n + 1, 4, 4)
    centre: Array
    radius: float


def arm_motion(robot: Robot, t: Array, angles: Array) -> ArmMotion:
    """Return the poses of the links along joint positions (N, n), at most 20 per second."""
    count = int(min(FRAMES_PER_SECOND * (t[-1] - t[0]) + 2, MOST_FRAMES, len(t)))
    rows = np.unique(np.searchsorted(t, np.linspace(t[0], t[-1], count)).clip(0, len(t) - 1))
    q = ca.SX.sym("q", robot.n)
    symbolic = [homogeneous(pose) for pose in link_poses(robot, Motion.of(q))]
    function = ca.Function("poses", [q], [ca.horzcat(*symbolic)])
    values = np.array(function.map(len(rows))(angles[rows].T).full())
    stacked = values.reshape(4, len(rows), robot.n + 1, 4)  # (row, frame, link, column)
    poses = np.ascontiguousarray(stacked.transpose(1, 2, 0, 3))
    tool = poses[:, -1] @ robot.tool
    points = np.concatenate([poses[:, :, :3, 3].reshape(-1, 3), tool[:, :3, 3]])
    low, high = points.min(axis=0), points.max(axis=0)
    return ArmMotion(t[rows], poses, 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))


def arm_meshes(robot: Robot, file: str) -> tuple[ArmMesh, ...]:
    """Return the surfaces of the links, and a drum along the axis of each joint, which marks it.

    Links have the visual meshes of the URDF ``file`` if all of them are found, else capsules.
    """
    capsules = capsules_of(robot)
    meshes = visual_meshes(robot, file)
    if not meshes:
        meshes = [ArmMesh(c.link, stl_bytes(revolved(c.start, c.end, c.radius))) for c in capsules]
    size = float(np.median([c.radius for c in capsules])) if capsules else 0.05
    for link, joint in enumerate(robot.joints, start=1):
        half = 1.3 * size * (joint.axis[:3] if joint.revolute else joint.axis[3:])
        middle = np.cross(joint.axis[:3], joint.axis[3:])  # nearest the origin on the joint's axis
        drum = revolved(middle - half, middle + half, 0.6 * size, flat=True)
        meshes.append(ArmMesh(link, stl_bytes(drum), drum=True))
    return tuple(meshes)


def revolved(start: Array, end: Array, radius: float, *, flat: bool = False) -> Array:
    """Return the triangles (F, 3, 3) of a capsule between two points, m; with flat ends, a drum."""
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    turn = np.linspace(0.0, 0.5 * np.pi, 2 if flat else 7)
    cap = np.column_stack([0.0 * turn if flat else radius * np.cos(turn), radius * np.sin(turn)])
    ends = cap[::-1] + np.array([length, 0.0])
    profile = np.concatenate([cap * [-1.0, 1.0], ends])  # along the axis, and from it
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND + 1)[:, None]
    rim = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    points = start + profile[:, None, :1] * axis + profile[:, None, 1:] * rim  # (P, AROUND + 1, 3)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    both = np.stack([np.stack([a, b, d], axis=-2), np.stack([a, d, c], axis=-2)])
    return np.asarray(both.reshape(-1, 3, 3))


logger = logging.getLogger("lieid_casadi")
TRIANGLE = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
)  # of a binary STL file
MOST_TRIANGLES = 200_000  # of all links; more are not sent to a browser
PARENTS = 4  # folders above the URDF in which its packages are looked for


def visual_meshes(robot: Robot, file: str) -> list[ArmMesh]:
    """Return the visual meshes of the links in their frames; none if a file of them is not found.

    ``package://NAME/…`` is looked for in the folders above the URDF ``file``, in
    ``ROS_PACKAGE_PATH`` and in ``AMENT_PREFIX_PATH``.
    """
    import pinocchio as pin

    model = UrdfModel.of(robot)
    if model is None or robot.source is None or "<mesh" not in robot.source.text:
        return []
    folder = Path(file).absolute().parent
    near = [str(folder), *map(str, list(folder.parents)[:PARENTS])]
    try:
        shapes = model.shapes(
            robot.source.text, pin.GeometryType.VISUAL, [*near, *package_folders()]
        )
    except (ValueError, RuntimeError) as error:
        logger.info("meshes of %s: %s", robot.name, " ".join(str(error).split()))
        return []
    meshes = []
    for link, shape in shapes:
        triangles = _triangles(shape)
        if triangles is None or not np.isfinite(triangles).all():
            return []  # primitive or damaged shapes; the capsules show the arm
        meshes.append((link, triangles))
    if sum(len(triangles) for _, triangles in meshes) > MOST_TRIANGLES:
        return []
    return [ArmMesh(link, stl_bytes(triangles)) for link, triangles in meshes]


def stl_bytes(triangles: Array) -> bytes:
    """Return triangles (F, 3, 3), m, as a binary STL file."""
    rows = np.zeros(len(triangles), TRIANGLE)
    rows["corners"] = triangles
    edges = triangles[:, 1:] - triangles[:, :1]
    normal = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    rows["normal"] = normal / np.where(length > 0.0, length, 1.0)
    return bytes(80) + np.uint32(len(triangles)).tobytes() + rows.tobytes()


def _triangles(shape: Any) -> Array | None:
    """Return the triangles (F, 3, 3) of a mesh in its link's frame, m; None if it is none."""
    geometry = shape.geometry
    if not hasattr(geometry, "num_tris"):
        return None
    corners = np.array(
        [[geometry.tri_indices(k)[c] for c in range(3)] for k in range(geometry.num_tris)],
        dtype=int,
    )
    rotation, origin = np.array(shape.placement.rotation), np.array(shape.placement.translation)
    points = np.array(geometry.vertices()) @ rotation.T + origin
    return np.asarray(points[corners.reshape(-1)].reshape(-1, 3, 3))
