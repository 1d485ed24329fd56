"""Capsules of a robot's links: bundled, fitted to its collision geometry, or its skeleton."""

from __future__ import annotations

import logging
import os
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import RobotError
from lieid_casadi.excitation.limits.capsules import Capsule, enclosing_all, skeleton
from lieid_casadi.robot import Robot
from lieid_casadi.robot.yaml_fields import FARTHEST, Field

Array = NDArray[np.float64]
logger = logging.getLogger("lieid_casadi")
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
            file = resources.files("lieid_casadi.excitation.limits").joinpath(
                "data", BUNDLED[robot.name]
            )
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
    from lieid_casadi.robot.text_file import read_text

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
