"""Links as capsules: given, fitted to collision geometry, or along the lines between joints."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RobotError
from lieid_casadi.robot import Robot
from lieid_casadi.robot.yaml_text import FARTHEST, Field

logger = logging.getLogger("lieid_casadi")
SKELETON_RADIUS = 0.06  # of the arm's length, where there is no geometry
SPLIT_VOLUME = 0.7  # of one capsule's volume: several capsules must be smaller in sum


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within ``radius`` of a segment, fixed to a link.

    Attributes
    ----------
    link : int
        0 for the base, i for the link that joint i (from 1) moves.
    start, end : (3,)
        In the link's frame, m.
    """

    link: int
    start: Array
    end: Array
    radius: float


def skeleton(robot: Robot, *, radius: float | None = None) -> tuple[Capsule, ...]:
    """Return capsules along the lines from joint to joint, for robots without geometry.

    Parameters
    ----------
    radius : float, optional
        m. Default: 6 % of the arm's length.
    """
    homes = [np.eye(4), *(joint.home for joint in robot.joints)]
    homes.append(robot.joints[-1].home @ robot.tool)
    steps = [np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in pairwise(homes)]
    size = SKELETON_RADIUS * float(np.sum(steps)) if radius is None else radius
    capsules = []
    for link in range(robot.n + 1):
        end = np.linalg.solve(homes[link], homes[link + 1])[:3, 3]
        if np.linalg.norm(end) > 1e-6:
            capsules.append(Capsule(link, np.zeros(3), end, size))
    return tuple(capsules)


def enclosing_all(
    link: int, points: Array, faces: NDArray[np.int64] | None = None, *, splits: int = 2
) -> list[Capsule]:
    """Return one capsule around points, or several where their volume is smaller.

    A mesh is cut in two across its longest direction; each triangle is inside one capsule.

    Parameters
    ----------
    link : int
    points : (N, 3)
        In the link's frame, m.
    faces : (F, 3), optional
        Triangles of a mesh.
    splits : int
        How often a part may be cut again.
    """
    whole = enclosing(link, points)
    if faces is None or splits == 0 or len(faces) < 8:
        return [whole]
    centred = points - points.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    middle = (centred @ axis)[faces].mean(axis=1)
    parts: list[Capsule] = []
    for chosen in (middle <= np.median(middle), middle > np.median(middle)):
        if not chosen.any():
            return [whole]
        used, renumbered = np.unique(faces[chosen], return_inverse=True)
        part = renumbered.reshape(-1, 3)
        parts += enclosing_all(link, points[used], part, splits=splits - 1)
    if sum(_volume(part) for part in parts) < SPLIT_VOLUME * _volume(whole):
        return parts
    return [whole]


def enclosing(link: int, points: Array) -> Capsule:
    """Return a small capsule that contains points (N, 3) of a link.

    The axis is the principal direction of the points with the smallest capsule; its ends are as
    close together as the spherical caps allow. No point is outside, but the capsule need not be
    the smallest one.
    """
    points = np.asarray(points, dtype=float)
    best: Capsule | None = None
    centred = points - points.mean(axis=0)
    _, _, directions = np.linalg.svd(centred, full_matrices=False)
    for axis in directions:
        capsule = _along(link, points, axis)
        if best is None or _volume(capsule) < _volume(best):
            best = capsule
    assert best is not None
    return best


def _along(link: int, points: Array, axis: Array) -> Capsule:
    along = points @ axis
    across = points - np.outer(along, axis)
    centre, radius = _enclosing_circle(across)
    gap = np.linalg.norm(across - centre, axis=1)
    cap = np.sqrt(np.maximum(radius**2 - gap**2, 0.0))
    low, high = float((along + cap).min()), float((along - cap).max())
    if low > high:  # a ball contains all points
        low = high = 0.5 * (low + high)
    ends = centre + low * axis, centre + high * axis
    slack = segment_distance_to_points(points, *ends).max()
    return Capsule(link, *ends, float(max(radius, slack)))


def _enclosing_circle(points: Array) -> tuple[Array, float]:
    """Return centre and radius of a nearly smallest ball (Ritter, then Badoiu-Clarkson steps)."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    for k in range(1, 200):
        gaps = np.linalg.norm(points - centre, axis=1)
        centre = centre + (points[np.argmax(gaps)] - centre) / (k + 1)
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _volume(capsule: Capsule) -> float:
    length = float(np.linalg.norm(capsule.end - capsule.start))
    return np.pi * capsule.radius**2 * (length + 4.0 / 3.0 * capsule.radius)


def segment_distance_to_points(points: Array, start: Array, end: Array) -> Array:
    """Return the distances (N,) of points from a segment.

    Parameters
    ----------
    points : (N, 3)
        m.
    start, end : (3,)
        Ends of the segment, m.
    """
    direction = end - start
    squared = float(direction @ direction)
    share = np.zeros(len(points))
    if squared > 0.0:
        share = np.clip((points - start) @ direction / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * direction, axis=1))


BUNDLED = {"panda": "panda.yaml", "panda_luo2024": "panda.yaml"}  # link frames are the same
RIM_POINTS = 24  # on the rim of a cylinder, outside of it, so that their hull contains it


def capsules_of(robot: Robot) -> tuple[Capsule, ...]:
    """Return the links as capsules.

    Bundled robots have bundled capsules. For a URDF they are fitted to the collision geometry, if
    its meshes are found (``package://`` in ``ROS_PACKAGE_PATH`` or ``AMENT_PREFIX_PATH``).
    Otherwise they follow the lines from joint to joint; designs list this as unchecked.
    """
    if robot.source is None or robot.source.kind != "urdf":
        if robot.name in BUNDLED:
            file = resources.files("lieid_casadi.excitation").joinpath("data", BUNDLED[robot.name])
            return parse_capsules(file.read_text("utf-8"), robot, origin=BUNDLED[robot.name])
    else:
        fitted = fitted_to_urdf(robot)
        if fitted:
            return fitted
    logger.info("%s: no collision geometry found; links follow the lines of joints", robot.name)
    return skeleton(robot)


def load_capsules(path: str | Path, robot: Robot) -> tuple[Capsule, ...]:
    """Read capsules from YAML: ``capsules: [{link, start, end, radius}]``; link 0 is the base.

    Raises
    ------
    RobotError
        Not YAML, a missing key, a link that the robot does not have.
    """
    from lieid_casadi.robot.description import read_text

    return parse_capsules(read_text(path), robot, origin=str(path))


def parse_capsules(text: str, robot: Robot, *, origin: str) -> tuple[Capsule, ...]:
    """Return capsules from YAML text; see `load_capsules`.

    Parameters
    ----------
    text : str
        YAML.
    robot : Robot
    origin : str
        Name of the file, for error messages.
    """
    rows = Field.top(text, origin).mapping(("capsules",))["capsules"]
    if not rows.items():
        raise rows.error("at least one capsule")
    return tuple(_capsule(row, robot) for row in rows.items())


def _capsule(row: Field, robot: Robot) -> Capsule:
    keys = row.mapping(("link", "start", "end", "radius"))
    link = keys["link"].number()
    if link not in range(robot.n + 1):
        raise keys["link"].error(f"0 (base) to {robot.n}")
    start, end = (keys[name].numbers(3, largest=FARTHEST) for name in ("start", "end"))
    return Capsule(int(link), start, end, keys["radius"].positive())


def fitted_to_urdf(robot: Robot) -> tuple[Capsule, ...]:
    """Return capsules that contain the collision geometry of a URDF; () if it is not found."""
    import pinocchio as pin

    source = robot.source
    if source is None or "<collision" not in source.text:
        return ()
    full = pin.buildModelFromXML(source.text)
    try:
        shapes = pin.buildGeomFromUrdfString(
            full, source.text, pin.GeometryType.COLLISION, None, _package_folders()
        )
    except (ValueError, RuntimeError) as error:
        logger.info("collision geometry of %s: %s", robot.name, " ".join(str(error).split()))
        return ()
    links = {joint.name: k + 1 for k, joint in enumerate(robot.joints)}
    locked = [full.getJointId(name) for name in list(full.names)[1:] if name not in links]
    reduced, [geometry] = pin.buildReducedModel(full, [shapes], locked, pin.neutral(full))
    capsules: list[Capsule] = []
    for shape in geometry.geometryObjects:
        link = links.get(reduced.names[shape.parentJoint], 0)
        capsules += _around(link, shape.geometry, shape.placement, shape.meshScale)
    return tuple(capsules)


def _package_folders() -> list[str]:
    stated = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    stated += [
        str(Path(prefix) / "share")
        for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        if prefix
    ]
    return [folder for folder in stated if folder]


def _around(link: int, shape: Any, placement: Any, scale: Array) -> list[Capsule]:
    """Return capsules that contain one collision shape."""
    import coal

    rotation, origin = np.array(placement.rotation), np.array(placement.translation)

    def placed(points: Any) -> Array:
        return np.asarray(np.asarray(points, dtype=float) @ rotation.T + origin)

    along = np.array([0.0, 0.0, 1.0])
    if isinstance(shape, coal.Sphere):
        return [Capsule(link, origin, origin, float(shape.radius))]
    if isinstance(shape, coal.Capsule):
        ends = placed([shape.halfLength * along, -shape.halfLength * along])
        return [Capsule(link, ends[0], ends[1], float(shape.radius))]
    if isinstance(shape, coal.Box):
        corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return enclosing_all(link, placed(corners * np.ravel(shape.halfSide)))
    if isinstance(shape, coal.Cylinder):
        angles = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
        rim = shape.radius / np.cos(np.pi / RIM_POINTS) * np.stack([np.cos(angles), np.sin(angles)])
        heights = np.repeat([shape.halfLength, -shape.halfLength], RIM_POINTS)
        return enclosing_all(link, placed(np.column_stack([np.tile(rim, 2).T, heights])))
    if hasattr(shape, "vertices"):
        triangles = [shape.tri_indices(k) for k in range(shape.num_tris)]
        faces = np.array([[triangle[corner] for corner in range(3)] for triangle in triangles])
        return enclosing_all(link, placed(np.array(shape.vertices())), faces)
    raise RobotError(f"collision shape {type(shape).__name__} is not supported; give --capsules")
