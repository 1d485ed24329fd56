"""Meshes of a URDF's links, where its files are found, as binary STL."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.robot import Robot
from lieid_casadi.workbench.computing.results import ArmMesh

Array = NDArray[np.float64]
logger = logging.getLogger("lieid_casadi")
TRIANGLE = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
)  # of a binary STL file
MOST_TRIANGLES = 200_000  # of all links; more are not sent to a browser
PARENTS = 4  # folders above the URDF in which its packages are looked for


def arm_meshes(robot: Robot, file: str) -> tuple[ArmMesh, ...]:
    """Return the visual meshes of the links in their frames; () if a file of them is not found.

    Parameters
    ----------
    robot : Robot
    file : str
        The URDF; ``package://NAME/…`` is looked for in the folders above it, in
        ``ROS_PACKAGE_PATH`` and in ``AMENT_PREFIX_PATH``.
    """
    import pinocchio as pin

    source = robot.source
    if source is None or source.kind != "urdf" or "<mesh" not in source.text:
        return ()
    full = pin.buildModelFromXML(source.text)
    try:
        shapes = pin.buildGeomFromUrdfString(
            full, source.text, pin.GeometryType.VISUAL, None, _folders(file)
        )
    except (ValueError, RuntimeError) as error:
        logger.info("meshes of %s: %s", robot.name, " ".join(str(error).split()))
        return ()
    links = {joint.name: k + 1 for k, joint in enumerate(robot.joints)}
    locked = [full.getJointId(name) for name in list(full.names)[1:] if name not in links]
    reduced, [geometry] = pin.buildReducedModel(full, [shapes], locked, pin.neutral(full))
    meshes = []
    for shape in geometry.geometryObjects:
        triangles = _triangles(shape)
        if triangles is None:
            return ()  # primitive shapes; the capsules show the arm
        meshes.append((links.get(reduced.names[shape.parentJoint], 0), triangles))
    if sum(len(triangles) for _, triangles in meshes) > MOST_TRIANGLES:
        return ()
    return tuple(ArmMesh(link, stl_bytes(triangles)) for link, triangles in meshes)


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


def _folders(file: str) -> list[str]:
    """Return the folders in which packages are looked for."""
    folder = Path(file).absolute().parent
    near = [str(folder), *(str(p) for p in list(folder.parents)[:PARENTS])]
    stated = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [*near, *(f for f in stated if f), *(f"{p}/share" for p in prefixes if p)]
