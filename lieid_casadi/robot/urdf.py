"""A serial arm from a URDF: its links and joints as checked data, and the chain to the tip.

Every number is checked by the names of the link or joint: URDF libraries drop what they cannot
read and continue without it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import (
    LieidWarning,
    MimicJointWarning,
    NominalInertiaWarning,
    RobotError,
)
from lieid_casadi.robot.description import (
    MOST_JOINTS,
    NOT_STATED,
    Joint,
    Limits,
    RobotDescription,
    RobotSource,
)
from lieid_casadi.robot.geometry import Geometry, pose, relative
from lieid_casadi.robot.inertia import (
    impossible_moments,
    link_parameters,
    parameter_transport,
    symmetric,
)

Element = ElementTree.Element

MOVABLE = ("revolute", "continuous", "prismatic")
MOST = 1000  # links, and joints
LARGEST = 1e12  # of any number, SI: products of a few of them stay far below overflow
FARTHEST = 1e6  # m, rad
LEAST_AXIS, LONGEST_AXIS = 1e-6, 1e6  # length of an axis before it is normalized
INERTIA = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_UNLIMITED = ("inf", "+inf", "-inf", "infinity", "+infinity", "-infinity")


@dataclass(frozen=True, eq=False)
class UrdfLink:
    """A link; ``com`` (4, 4) is the pose of its inertia, ``inertia`` (6,) as in `INERTIA`."""

    name: str
    mass: float
    com: Geometry
    inertia: Array


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint; ``pose`` (4, 4) of its frame in the parent link, ``axis`` (3,) of unit length."""

    name: str
    kind: str
    parent: str
    child: str
    pose: Geometry
    axis: Array
    limits: Limits
    mimics: str

    @property
    def movable(self) -> bool:
        """Whether the joint has a degree of freedom."""
        return self.kind in MOVABLE


def read_urdf(
    text: str, *, tip: str | None = None, lock: Sequence[str] = (), origin: str = "URDF"
) -> RobotDescription:
    """Return the serial arm that a URDF describes.

    The chain runs from the root link to ``tip``. Joints in ``lock``, and joints on branches
    off the chain, are locked at zero and their links lumped into the link that carries them.
    Meshes are not read.
    """
    root = _xml(text, origin)
    links, joints = read_elements(root, origin)
    parents = check_tree(joints, [link.name for link in links], origin)
    chain = serial_chain(joints, parents, tip=tip, lock=lock, origin=origin)
    last = tip_link(joints, chain, tip)
    made, tool = _arm(links, joints, parents, chain, last, origin)
    return RobotDescription(
        name=root.get("name") or "robot",
        joints=made,
        tool=tool,
        source=RobotSource("urdf", text, tip, tuple(lock)),
        warnings=(*_inertia_warnings(links, origin), *_mimic_warnings(joints, origin)),
        tool_name=last,
    )


def _arm(
    links: Sequence[UrdfLink],
    joints: Sequence[UrdfJoint],
    parents: dict[str, UrdfJoint],
    chain: Sequence[UrdfJoint],
    tip: str,
    origin: str,
) -> tuple[tuple[Joint, ...], Geometry]:
    """Return the joints of the chain, and the tip's pose (4, 4) in the last link."""
    numbers = {joint.name: k for k, joint in enumerate(chain)}
    below: dict[str, list[UrdfJoint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    (root,) = (link.name for link in links if link.name not in parents)
    frames, carrier = {root: np.eye(4)}, {root: -1}  # at zero; joint of the chain that moves it
    waiting = [root]
    while waiting:
        link = waiting.pop()
        for joint in below.get(link, ()):
            frames[joint.child] = frames[link] @ joint.pose
            carrier[joint.child] = numbers.get(joint.name, carrier[link])
            waiting.append(joint.child)
    if carrier[tip] != len(chain) - 1:
        raise RobotError(f"{origin}: link {tip!r} does not move with the last joint of the chain")
    carried = np.zeros((len(chain), 10))
    for element in links:
        k = carrier[element.name]
        if k >= 0:
            body = relative(frames[chain[k].child], frames[element.name] @ element.com)
            own = link_parameters(element.mass, np.zeros(3), symmetric(element.inertia))
            carried[k] += parameter_transport(body) @ own
    made = []
    for joint, link_inertia in zip(chain, carried, strict=True):
        home = frames[joint.child]
        axis, still = home[:3, :3] @ joint.axis, np.zeros(3)
        turning = np.concatenate([axis, np.cross(home[:3, 3], axis)])
        made.append(
            Joint(
                name=joint.name,
                screw=np.concatenate([still, axis]) if joint.kind == "prismatic" else turning,
                home=home,
                limits=joint.limits,
                link=link_inertia if link_inertia[0] > 0.0 else None,
                link_name=joint.child,
            )
        )
    return tuple(made), relative(frames[chain[-1].child], frames[tip])


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
    name, inertial = element.get("name", ""), element.find("inertial")
    if inertial is None:
        return UrdfLink(name, 0.0, np.eye(4), np.zeros(6))
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        lacking = "mass" if mass is None else "inertia"
        raise RobotError(f"{where}: <inertial> has no <{lacking}>; add it or remove <inertial>")
    stated = _number(mass, "value", where)
    if stated < 0.0:
        raise RobotError(f"{where}: mass is {stated:g} kg, expected 0 or more")
    six = np.array([_number(inertia, name, where) for name in INERTIA])
    return UrdfLink(name, stated, _pose(inertial, f"{where}: inertial"), six)


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
    return UrdfJoint(
        element.get("name", ""),
        kind,
        parent.get("link", ""),
        child.get("link", ""),
        _pose(element, where),
        _axis(element, where) if movable else np.array([1.0, 0.0, 0.0]),
        _limits(element, kind, where) if movable else Limits(),
        "" if mimic is None else mimic.get("joint", "another joint"),
    )


def _pose(element: Element, where: str) -> Geometry:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    return pose(_three(origin, "xyz", where), _three(origin, "rpy", where))


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


def check_tree(
    joints: Sequence[UrdfJoint], links: Sequence[str], origin: str
) -> dict[str, UrdfJoint]:
    """Return the joint that carries each link but the root."""
    known = set(links)
    parents: dict[str, UrdfJoint] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in known:
                raise RobotError(f"{origin}: joint {joint.name!r} names unknown link {link!r}")
        if joint.child in parents:
            raise RobotError(
                f"{origin}: loop: link {joint.child!r} is carried by joints "
                f"{parents[joint.child].name!r} and {joint.name!r}; expected a tree"
            )
        parents[joint.child] = joint
    if not links:
        raise RobotError(
            f"{origin}: no links; expected a URDF (a xacro file must be expanded first: "
            "xacro arm.urdf.xacro > arm.urdf)"
        )
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        what = "a loop without a root" if not roots else f"{len(roots)} roots: {', '.join(roots)}"
        raise RobotError(f"{origin}: expected one root link, found {what}")
    for link in links:
        path_to_root(link, parents, origin)
    return parents


def path_to_root(link: str, parents: dict[str, UrdfJoint], origin: str) -> list[UrdfJoint]:
    """Return the joints from the root to a link."""
    path: list[UrdfJoint] = []
    while link in parents:
        path.append(parents[link])
        link = parents[link].parent
        if len(path) > len(parents):
            raise RobotError(f"{origin}: loop through link {link!r}; expected a tree")
    return path[::-1]


def serial_chain(
    joints: Sequence[UrdfJoint],
    parents: dict[str, UrdfJoint],
    *,
    tip: str | None,
    lock: Sequence[str],
    origin: str,
) -> list[UrdfJoint]:
    """Return the movable joints from the root to the tip that are not locked."""
    if tip is not None and tip not in {link for j in joints for link in (j.parent, j.child)}:
        links = dict.fromkeys(link for j in joints for link in (j.parent, j.child))
        raise RobotError(f"{origin}: no link {tip!r}; links are {', '.join(links)}")
    movable = [joint for joint in joints if joint.movable]
    for name in lock:
        if name not in {joint.name for joint in movable}:
            known = ", ".join(joint.name for joint in movable)
            raise RobotError(f"{origin}: no movable joint {name!r}; joints are {known}")
    free = [joint for joint in movable if joint.name not in lock]
    if tip is not None:
        chain = [joint for joint in path_to_root(tip, parents, origin) if joint in free]
    else:
        paths = [[j for j in path_to_root(j.child, parents, origin) if j in free] for j in free]
        chain = max(paths, key=len, default=[])
        branch = [joint.name for joint in free if joint not in chain]
        if branch:
            raise RobotError(
                f"{origin}: not one serial chain: {', '.join(branch)} "
                f"{'branches' if len(branch) == 1 else 'branch'} off "
                f"{' → '.join(j.name for j in chain)}; choose --tip LINK or --lock JOINT…"
            )
    if not chain:
        raise RobotError(f"{origin}: no movable joint between the root and the tip")
    if len(chain) > MOST_JOINTS:
        raise RobotError(
            f"{origin}: found a chain of {len(chain)} joints; expected at most {MOST_JOINTS}"
        )
    for joint in chain:
        if joint.mimics:
            raise RobotError(
                f"{origin}: joint {joint.name!r} mimics {joint.mimics!r}; expected independent "
                f"joints: lock it (--lock {joint.name}) or remove <mimic>"
            )
    return chain


def tip_link(joints: Sequence[UrdfJoint], chain: Sequence[UrdfJoint], tip: str | None) -> str:
    """Return the tip; if none is given, the last of the fixed links after the chain."""
    if tip is not None:
        return tip
    link = chain[-1].child
    while True:
        following = [j.child for j in joints if j.parent == link and j.kind == "fixed"]
        if len(following) != 1:
            return link
        link = following[0]


def _xml(text: str, origin: str) -> ElementTree.Element:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise RobotError(f"{origin}: not a URDF: found a document type or entity definition")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise RobotError(f"{origin}: not XML: {error}") from None
    if root.tag != "robot":
        found = root.tag[:60]
        raise RobotError(f"{origin}: not a URDF: root element is <{found}>, expected <robot>")
    return root


def _mimic_warnings(joints: Sequence[UrdfJoint], origin: str) -> list[LieidWarning]:
    """Return warnings of joints that follow others; in the chain they are refused before."""
    return [
        MimicJointWarning(
            f"{origin}: joint {joint.name!r} mimics {joint.mimics!r}, which is not modelled: it is "
            "kept at zero"
        )
        for joint in joints
        if joint.mimics and joint.movable
    ]


def _inertia_warnings(links: Sequence[UrdfLink], origin: str) -> list[LieidWarning]:
    warnings: list[LieidWarning] = []
    for link in links:
        fault = impossible_moments([0.0, 0.0, 0.0, 0.0, *link.inertia])
        if fault is not None:
            warnings.append(
                NominalInertiaWarning(
                    f"{origin}: link {link.name!r}: its inertia has {fault} which is physically "
                    "impossible"
                )
            )
    return warnings
