"""The links and joints of a URDF as checked data.

Every number is checked here, by the names of the link or joint, because URDF libraries drop what
they cannot read and continue without it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RobotError
from lieid_casadi.robot.description import NOT_STATED, Limits
from lieid_casadi.robot.inertia import link_parameters, pose, symmetric
from lieid_casadi.robot.yaml_text import FARTHEST, LARGEST

Element = ElementTree.Element

MOVABLE = ("revolute", "continuous", "prismatic")
MOST = 1000  # links, and joints
LEAST_AXIS, LONGEST_AXIS = 1e-6, 1e6  # length of an axis before it is normalized
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_UNLIMITED = ("inf", "+inf", "-inf", "infinity", "+infinity", "-infinity")


@dataclass(frozen=True, eq=False)
class UrdfLink:
    """A link; ``com`` xyz (3,) and rpy (3,), ``inertia`` (6,) in the order of `INERTIA`."""

    name: str
    mass: float
    com_xyz: Array
    com_rpy: Array
    inertia: Array

    @property
    def parameters(self) -> Array:
        """Link parameters (10,) about the origin of the link frame."""
        xx, xy, xz, yy, yz, zz = self.inertia
        place = pose(self.com_xyz, self.com_rpy)
        turned = place[:3, :3] @ symmetric([xx, xy, yy, xz, yz, zz]) @ place[:3, :3].T
        return link_parameters(self.mass, place[:3, 3], turned)


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint; ``xyz`` (3,) m and ``rpy`` (3,) rad of its frame, ``axis`` (3,) of unit length."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: Array
    rpy: Array
    axis: Array
    limits: Limits
    mimics: str

    @property
    def movable(self) -> bool:
        """Whether the joint has a degree of freedom."""
        return self.kind in MOVABLE


def read_elements(root: Element, origin: str) -> tuple[list[UrdfLink], list[UrdfJoint]]:
    """Return the links and joints of a URDF."""
    links = [_link(e, f"{origin}: link {_name(e, origin)!r}") for e in root.findall("link")]
    joints = [_joint(e, f"{origin}: joint {_name(e, origin)!r}") for e in root.findall("joint")]
    for what, names in (("link", [x.name for x in links]), ("joint", [x.name for x in joints])):
        if len(names) > MOST:
            raise RobotError(f"{origin}: found {len(names)} {what}s; expected at most {MOST}")
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise RobotError(
                f"{origin}: {what} name {twice!r} is given twice; expected unique names"
            )
    return links, joints


def _name(element: Element, origin: str) -> str:
    name = element.get("name", "")
    if not name:
        raise RobotError(f"{origin}: found a <{element.tag}> without a name")
    return name


def _link(element: Element, where: str) -> UrdfLink:
    name, zero = element.get("name", ""), np.zeros(3)
    inertial = element.find("inertial")
    if inertial is None:
        return UrdfLink(name, 0.0, zero, zero, np.zeros(6))
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        lacking = "mass" if mass is None else "inertia"
        raise RobotError(f"{where}: <inertial> has no <{lacking}>; add it or remove <inertial>")
    stated = _number(mass, "value", where)
    if stated < 0.0:
        raise RobotError(f"{where}: mass is {stated:g} kg, expected 0 or more")
    xyz, rpy = _pose(inertial, f"{where}: inertial")
    return UrdfLink(name, stated, xyz, rpy, np.array([_number(inertia, k, where) for k in INERTIA]))


def _joint(element: Element, where: str) -> UrdfJoint:
    kind = element.get("type", "")
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise RobotError(f"{where} lacks <parent> or <child>")
    if kind not in (*MOVABLE, "fixed"):
        raise RobotError(
            f"{where} is of type {kind!r}; expected revolute, continuous, prismatic or fixed"
        )
    movable, mimic = kind in MOVABLE, element.find("mimic")
    xyz, rpy = _pose(element, where)
    return UrdfJoint(
        element.get("name", ""),
        kind,
        parent.get("link", ""),
        child.get("link", ""),
        xyz,
        rpy,
        _axis(element, where) if movable else np.array([1.0, 0.0, 0.0]),
        _limits(element, kind, where) if movable else Limits(),
        "" if mimic is None else mimic.get("joint", "another joint"),
    )


def _pose(element: Element, where: str) -> tuple[Array, Array]:
    origin = element.find("origin")
    if origin is None:
        return np.zeros(3), np.zeros(3)
    return _three(origin, "xyz", where), _three(origin, "rpy", where)


def _axis(element: Element, where: str) -> Array:
    """Return the unit axis (3,); URDF's default is x."""
    stated = element.find("axis")
    if stated is None:
        return np.array([1.0, 0.0, 0.0])
    axis = _three(stated, "xyz", f"{where}: axis", largest=LARGEST)
    length = float(np.linalg.norm(axis))
    if not LEAST_AXIS <= length <= LONGEST_AXIS:
        raise RobotError(
            f"{where}: axis xyz={stated.get('xyz', '')[:60]!r} has length {length:g}; "
            "expected a direction of length 1"
        )
    return axis / length


def _limits(element: Element, kind: str, where: str) -> Limits:
    limit = element.find("limit")
    if limit is None:
        return Limits()
    lower, upper, velocity, effort = (
        _limit(limit, name, where) for name in ("lower", "upper", "velocity", "effort")
    )
    stated = {"lower", "upper"} & set(limit.keys())
    if stated == {"lower"}:
        upper = 0.0  # the default of the format, where one of both is stated
    elif stated == {"upper"}:
        lower = 0.0
    lower, upper = _within_soft_limits(element, lower, upper, where)
    if kind == "continuous":
        lower = upper = NOT_STATED
    if lower >= upper:
        raise RobotError(
            f"{where}: limits lower={lower:g}, upper={upper:g}; expected lower < upper"
        )
    for name, value in (("velocity", velocity), ("effort", effort)):
        if value < 0.0:
            raise RobotError(f"{where}: limit {name}={value:g}; expected 0 or more")
    return Limits(
        position_lower=lower,
        position_upper=upper,
        velocity=velocity or NOT_STATED,
        torque=effort or NOT_STATED,
    )


def _within_soft_limits(
    element: Element, lower: float, upper: float, where: str
) -> tuple[float, float]:
    """Return position limits narrowed by those at which the joint's safety controller acts."""
    safety = element.find("safety_controller")
    if safety is None:
        return lower, upper
    first, last = (_limit(safety, f"soft_{name}_limit", where) for name in ("lower", "upper"))
    if first == last:  # the default of the format: not stated
        return lower, upper
    return float(np.fmax(lower, first)), float(np.fmin(upper, last))


def _limit(limit: Element, name: str, where: str) -> float:
    """Return a limit, NaN where it is absent or infinite."""
    text = limit.get(name)
    if text is None or text.strip().lower() in _UNLIMITED:
        return NOT_STATED
    return _parsed(text, f"{where}: limit {name}", LARGEST)


def _number(element: Element, attribute: str, where: str) -> float:
    return _parsed(element.get(attribute, ""), f"{where}: {element.tag} {attribute}", LARGEST)


def _three(element: Element, attribute: str, where: str, largest: float = FARTHEST) -> Array:
    text = element.get(attribute)
    if text is None:
        return np.zeros(3)
    words = text.split()
    if len(words) != 3:
        raise RobotError(f"{where}: {attribute}={text[:60]!r}; expected three numbers")
    return np.array([_parsed(word, f"{where}: {attribute}", largest) for word in words])


def _parsed(text: str, where: str, largest: float) -> float:
    if not _NUMBER.fullmatch(text.strip()):
        raise RobotError(f"{where}={text[:60]!r} is not a number")
    value = float(text)
    if not math.isfinite(value) or abs(value) > largest:
        raise RobotError(f"{where}={text[:60]!r}; expected a number of at most {largest:g}")
    return value
