"""Links as capsules: given, fitted to collision geometry, or along the lines between joints."""

from __future__ import annotations

import os
from copy import deepcopy
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RobotError
from lieid_casadi.robot import Robot
from lieid_casadi.robot.urdf import silenced
from lieid_casadi.robot.yaml_text import FARTHEST, Field

SKELETON_RADIUS = 0.06  # of the arm's length, where there is no geometry
RIM_POINTS = 24  # on the rim of a cylinder, outside of it, so that their hull contains it
BUNDLED = {"panda.yaml": ("panda", "panda_luo2024")}  # capsules → robots with these link frames
WIDE = {"lower": "-1e6", "upper": "1e6", "effort": "1e6", "velocity": "1e6"}


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within ``radius`` (m) of a segment (m), fixed to the frame of a link.

    ``link`` is 0 for the base, i for the link that joint i (from 1) moves; ``source`` is ``given``,
    ``shape`` for one that contains a URDF's collision geometry, or ``line`` for one along the line
    between two joints, where the shape of the link is unknown.
    """

    link: int
    start: Array
    end: Array
    radius: float
    source: Literal["given", "shape", "line"] = "given"


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape of a link: of the library coal, placed in the link's frame.

    It is in the hull of balls of ``radius`` around ``points`` (k, 3), m.
    """

    link: int
    geometry: Any
    rotation: Array
    origin: Array
    points: Array
    radius: float


def capsules_of(robot: Robot) -> tuple[Capsule, ...]:
    """Return the links as capsules.

    A URDF's collision geometry is enclosed by capsules where its meshes are found (``package://``
    in ``ROS_PACKAGE_PATH`` or ``AMENT_PREFIX_PATH``). The Panda has bundled ones. Every link of
    which a part is unknown has a capsule along the line between its joints; designs list its shape
    as unchecked.
    """
    shapes, unknown = collision_shapes(robot)
    found = tuple(map(_around, shapes))
    if not found:
        found, unknown = _bundled(robot), ()
    moving = {name: link for name, link, _ in fixed_frames(robot)}
    have = {capsule.link for capsule in found} - {moving.get(name, 0) for name in unknown}
    return (*found, *(line for line in skeleton(robot) if line.link not in have))


def skeleton(robot: Robot) -> tuple[Capsule, ...]:
    """Return capsules along the lines from joint to joint, for robots without geometry.

    A moving link of zero length is a ball; the last one reaches to its farthest frame.
    """
    homes = _frames(robot)
    size = SKELETON_RADIUS * arm_length(robot)
    capsules = []
    for link in range(robot.n + 1):
        end = np.array(np.linalg.solve(homes[link], homes[link + 1])[:3, 3], dtype=np.float64)
        if link == robot.n:  # the tool, or a frame beyond it
            beyond = [point for _, other, point in fixed_frames(robot) if other == link]
            end = max([end, *beyond], key=lambda point: float(np.linalg.norm(point)))
        long = np.linalg.norm(end) > 1e-6
        if size > 0.0 and (long or link):
            end = end if long else np.zeros(3)
            capsules.append(Capsule(link, np.zeros(3), end, size, "line"))
    return tuple(capsules)


def _frames(robot: Robot) -> list[Array]:
    """Return the frames of the base, the links and the tool at q = 0, in the base frame."""
    homes = [np.eye(4), *(joint.home for joint in robot.joints)]
    return [*homes, homes[-1] @ robot.tool]


def arm_length(robot: Robot) -> float:
    """Return the length of all steps from frame to frame, m."""
    return float(sum(np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in pairwise(_frames(robot))))


def _bundled(robot: Robot) -> tuple[Capsule, ...]:
    """Return bundled capsules, for robots with the link frames of a bundled robot."""
    frames = np.array([joint.home for joint in robot.joints])
    for file, names in BUNDLED.items():
        for name in names:
            other = np.array([joint.home for joint in Robot.load(name).joints])
            if frames.shape == other.shape and np.allclose(frames, other, atol=1e-6):
                text = resources.files("lieid_casadi.excitation").joinpath("data", file)
                return parse_capsules(text.read_text("utf-8"), robot, origin=file)
    return ()


def load_capsules(path: str | Path, robot: Robot) -> tuple[Capsule, ...]:
    """Read capsules from YAML: ``capsules: [{link, start, end, radius}]``; link 0 is the base."""
    from lieid_casadi.robot.description import read_text

    return parse_capsules(read_text(path), robot, origin=str(path))


def parse_capsules(text: str, robot: Robot, *, origin: str) -> tuple[Capsule, ...]:
    """Return capsules from YAML text; see `load_capsules`. ``origin`` is named in errors."""
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


@dataclass(frozen=True, eq=False)
class UrdfModel:
    """A URDF in Pinocchio, whose joints have one coordinate each and no limits."""

    root: ElementTree.Element
    full: Any
    reduced: Any
    locked: list[int]
    links: dict[str, int]

    @classmethod
    def of(cls, robot: Robot) -> UrdfModel | None:
        """Return the model of a robot's URDF; None if it has none that Pinocchio reads."""
        import pinocchio as pin

        if robot.source is None or robot.source.kind != "urdf":
            return None
        root = ElementTree.fromstring(robot.source.text)
        for joint in root.findall("joint"):
            for tag in ("limit", "mimic", "safety_controller"):
                for element in joint.findall(tag):
                    joint.remove(element)
            if joint.get("type") == "continuous":
                joint.set("type", "revolute")
            ElementTree.SubElement(joint, "limit", WIDE)
        try:
            with silenced():
                full = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
        except (ValueError, RuntimeError):
            return None
        links = {joint.name: k + 1 for k, joint in enumerate(robot.joints)}
        locked = [full.getJointId(name) for name in list(full.names)[1:] if name not in links]
        reduced = pin.buildReducedModel(full, locked, pin.neutral(full))
        return cls(root, full, reduced, locked, links)

    def link_of(self, joint: int) -> int:
        """Return the link (0 for the base) that a joint of the reduced model moves."""
        return self.links.get(self.reduced.names[joint], 0)

    def shapes(self, text: str, kind: Any, folders: list[str]) -> list[tuple[int, Any]]:
        """Return the shapes of a kind, and their links; raises what Pinocchio does."""
        import pinocchio as pin

        with silenced():
            every = pin.buildGeomFromUrdfString(self.full, text, kind, None, folders)
        neutral = pin.neutral(self.full)
        _, [geometry] = pin.buildReducedModel(self.full, [every], self.locked, neutral)
        return [(self.link_of(g.parentJoint), g) for g in geometry.geometryObjects]


def fixed_frames(robot: Robot) -> list[tuple[str, int, Array]]:
    """Return name, link (from 1) and origin (3,) of every moving link frame of a URDF, m."""
    import pinocchio as pin

    model = UrdfModel.of(robot)
    if model is None:
        return []
    return [
        (frame.name, model.link_of(frame.parentJoint), np.array(frame.placement.translation))
        for frame in model.reduced.frames
        if frame.type == pin.FrameType.BODY and model.link_of(frame.parentJoint)
    ]


def collision_shapes(robot: Robot) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    """Return the collision geometry of a URDF, and the names of links of unknown shape."""
    import pinocchio as pin

    model = UrdfModel.of(robot)
    if model is None:
        return (), ()
    shapes: list[Shape] = []
    unknown: list[str] = []
    for link in model.root.findall("link"):
        name = link.get("name", "")
        if link.find("collision") is None:
            unknown += [name] if link.find("visual") is not None else []
            continue
        text, kind = _with_shapes_of(model.root, name), pin.GeometryType.COLLISION
        try:
            placed = model.shapes(text, kind, package_folders())
        except (ValueError, RuntimeError):
            unknown.append(name)
            continue
        shapes += [_shape(link, shape) for link, shape in placed]
    return tuple(shapes), tuple(unknown)


def _with_shapes_of(root: ElementTree.Element, name: str) -> str:
    """Return a URDF with the collision geometry of one link alone."""
    copy = deepcopy(root)
    for link in copy.findall("link"):
        for kind in ("collision", "visual"):
            for element in link.findall(kind):
                if kind == "visual" or link.get("name") != name:
                    link.remove(element)
    return ElementTree.tostring(copy, encoding="unicode")


def package_folders() -> list[str]:
    """Return the folders in which ROS looks for packages."""
    stated = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [*(f for f in stated if f), *(f"{p}/share" for p in prefixes if p)]


def _shape(link: int, placed: Any) -> Shape:
    """Return a shape of Pinocchio's geometry model."""
    import coal

    shape, along = placed.geometry, np.array([0.0, 0.0, 1.0])
    radius = 0.0
    if isinstance(shape, coal.Sphere):
        points, radius = np.zeros((1, 3)), float(shape.radius)
    elif isinstance(shape, coal.Capsule):
        points = np.array([-shape.halfLength * along, shape.halfLength * along])
        radius = float(shape.radius)
    elif isinstance(shape, coal.Box):
        corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        points = corners * np.ravel(shape.halfSide)
    elif isinstance(shape, coal.Cylinder):
        angles = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
        rim = shape.radius / np.cos(np.pi / RIM_POINTS) * np.stack([np.cos(angles), np.sin(angles)])
        heights = np.repeat([shape.halfLength, -shape.halfLength], RIM_POINTS)
        points = np.column_stack([np.tile(rim, 2).T, heights])
    elif hasattr(shape, "vertices"):
        points = np.array(shape.vertices())
    else:
        kind = type(shape).__name__
        raise RobotError(f"collision shape {kind} is not supported; give --capsules")
    rotation, origin = np.array(placed.placement.rotation), np.array(placed.placement.translation)
    return Shape(link, shape, rotation, origin, points @ rotation.T + origin, radius)


def _around(shape: Shape) -> Capsule:
    """Return a capsule that contains a shape."""
    if shape.radius > 0.0:
        ends = shape.points[-1], shape.points[0]
        return Capsule(shape.link, *ends, shape.radius, "shape")
    return enclosing(shape.link, shape.points)


def enclosing(link: int, points: Array) -> Capsule:
    """Return a small capsule that contains points (N, 3) of a link.

    The axis is the principal direction of the points with the smallest capsule; its ends are as
    close together as the spherical caps allow. No point is outside, but the capsule need not be
    the smallest one.
    """
    points = np.asarray(points, dtype=float)
    directions = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    return min((_along(link, points, axis) for axis in directions), key=_volume)


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
    return Capsule(link, *ends, float(max(radius, slack)), "shape")


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
    """Return the distances (N,) of points (N, 3) from the segment between two ends (3,), m."""
    direction = end - start
    squared = float(direction @ direction)
    share = np.zeros(len(points))
    if squared > 0.0:
        share = np.clip((points - start) @ direction / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * direction, axis=1))
