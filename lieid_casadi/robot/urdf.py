"""A serial arm from a URDF: Pinocchio parses it, and only the data leaves this file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from lieid_casadi.errors import RobotError
from lieid_casadi.robot.robot import NOT_STATED, Joint, Limits, Robot, RobotSource

MOVABLE = ("revolute", "continuous", "prismatic")
SAFETY_MARGIN = 1e6  # stands in for limits that URDF demands but the file does not state


@dataclass(frozen=True)
class UrdfJoint:
    """What the chain search needs of a URDF joint."""

    name: str
    kind: str
    parent: str
    child: str


def parse_urdf(
    text: str, *, tip: str | None = None, lock: Sequence[str] = (), origin: str = "URDF"
) -> Robot:
    """Return the serial arm that a URDF describes.

    The chain runs from the root link to ``tip``. Joints in ``lock``, and joints on branches
    off the chain, are locked at zero and their links lumped into the link that carries them,
    as in Pinocchio's reduced model. Meshes are not read.

    Parameters
    ----------
    text : str
        The URDF.
    tip : str, optional
        Last link. Without it the movable joints that are not locked must form one chain.
    lock : sequence of str
        Joints to lock at zero.
    origin : str
        Named in errors.

    Raises
    ------
    RobotError
        Not XML, a loop, a floating or planar joint, an ambiguous chain, unknown names.
    """
    root = _xml(text, origin)
    joints = _joints(root, origin)
    links = [element.get("name", "") for element in root.findall("link")]
    parents = _parents(joints, links, origin)
    _check_names(joints, links, tip, lock, origin)
    _check_masses(root, origin)
    chain = _chain(joints, parents, tip, lock, origin)
    model, tool = _reduced_model(root, joints, chain, _tip_link(joints, chain, tip), origin)
    elements = {element.get("name", ""): element for element in root.findall("joint")}
    return Robot(
        name=root.get("name") or "robot",
        joints=_screws(model, chain, elements, origin),
        gravity=np.array(model.gravity.linear),
        tool=tool,
        source=RobotSource("urdf", text, tip, tuple(lock)),
    )


def _xml(text: str, origin: str) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise RobotError(f"{origin}: not XML: {error}") from None
    if root.tag != "robot":
        raise RobotError(f"{origin}: not a URDF: root element is <{root.tag}>, expected <robot>")
    return root


def _joints(root: ElementTree.Element, origin: str) -> list[UrdfJoint]:
    joints = []
    for element in root.findall("joint"):
        name, kind = element.get("name", ""), element.get("type", "")
        parent, child = element.find("parent"), element.find("child")
        if parent is None or child is None:
            raise RobotError(f"{origin}: joint {name!r} lacks <parent> or <child>")
        if kind not in (*MOVABLE, "fixed"):
            raise RobotError(
                f"{origin}: joint {name!r} is of type {kind!r}; "
                "expected revolute, continuous, prismatic or fixed"
            )
        joints.append(UrdfJoint(name, kind, parent.get("link", ""), child.get("link", "")))
    return joints


def _parents(joints: list[UrdfJoint], links: list[str], origin: str) -> dict[str, UrdfJoint]:
    """Map each link to the joint that carries it; refuse loops and unknown links."""
    parents: dict[str, UrdfJoint] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise RobotError(f"{origin}: joint {joint.name!r} names unknown link {link!r}")
        if joint.child in parents:
            raise RobotError(
                f"{origin}: loop: link {joint.child!r} is carried by joints "
                f"{parents[joint.child].name!r} and {joint.name!r}; expected a tree"
            )
        parents[joint.child] = joint
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        what = "a loop without a root" if not roots else f"{len(roots)} roots: {', '.join(roots)}"
        raise RobotError(f"{origin}: expected one root link, found {what}")
    for link in links:
        _path_to_root(link, parents, origin)
    return parents


def _path_to_root(link: str, parents: dict[str, UrdfJoint], origin: str) -> list[UrdfJoint]:
    path: list[UrdfJoint] = []
    while link in parents:
        path.append(parents[link])
        link = parents[link].parent
        if len(path) > len(parents):
            raise RobotError(f"{origin}: loop through link {link!r}; expected a tree")
    return path[::-1]


def _check_names(
    joints: list[UrdfJoint], links: list[str], tip: str | None, lock: Sequence[str], origin: str
) -> None:
    if tip is not None and tip not in links:
        raise RobotError(f"{origin}: no link {tip!r}; links are {', '.join(links)}")
    movable = [joint.name for joint in joints if joint.kind in MOVABLE]
    for name in lock:
        if name not in movable:
            known = ", ".join(movable)
            raise RobotError(f"{origin}: no movable joint {name!r}; joints are {known}")


def _check_masses(root: ElementTree.Element, origin: str) -> None:
    """Refuse negative masses: lumped with a heavier neighbour they would go unnoticed."""
    for link in root.findall("link"):
        mass = link.find("inertial/mass")
        stated = "" if mass is None else mass.get("value", "")
        if stated.strip().startswith("-") and float(stated) < 0.0:
            raise RobotError(
                f"{origin}: link {link.get('name', '')!r}: mass is {stated} kg, expected 0 or more"
            )


def _chain(
    joints: list[UrdfJoint],
    parents: dict[str, UrdfJoint],
    tip: str | None,
    lock: Sequence[str],
    origin: str,
) -> list[UrdfJoint]:
    """Return the free movable joints from root to tip."""
    free = [j for j in joints if j.kind in MOVABLE and j.name not in lock]
    if tip is not None:
        path = _path_to_root(tip, parents, origin)
        chain = [joint for joint in path if joint in free]
    else:
        paths = [[j for j in _path_to_root(j.child, parents, origin) if j in free] for j in free]
        chain = max(paths, key=len, default=[])
        branch = [joint.name for joint in free if joint not in chain]
        if branch:
            raise RobotError(
                f"{origin}: not one serial chain: {', '.join(branch)} branch off "
                f"{' → '.join(j.name for j in chain)}; choose --tip LINK or --lock JOINT…"
            )
    if not chain:
        raise RobotError(f"{origin}: no movable joint left between the root and the tip")
    return chain


def _tip_link(joints: list[UrdfJoint], chain: list[UrdfJoint], tip: str | None) -> str:
    """Return the tip, or where it is not given the end of the fixed links after the chain."""
    if tip is not None:
        return tip
    link = chain[-1].child
    while True:
        following = [j.child for j in joints if j.parent == link and j.kind == "fixed"]
        if len(following) != 1:
            return link
        link = following[0]


def _reduced_model(
    root: ElementTree.Element,
    joints: list[UrdfJoint],
    chain: list[UrdfJoint],
    tip: str,
    origin: str,
) -> tuple[Any, np.ndarray]:
    """Return Pinocchio's model of the chain alone and the tip's pose in the last link."""
    import pinocchio as pin

    try:
        full = pin.buildModelFromXML(ElementTree.tostring(_normalized(root), encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise RobotError(f"{origin}: Pinocchio cannot read it: {reason}") from None
    names = {joint.name for joint in chain}
    locked = [full.getJointId(j.name) for j in joints if j.kind in MOVABLE and j.name not in names]
    model = pin.buildReducedModel(full, locked, np.zeros(full.nq))
    frame = model.frames[model.getFrameId(tip)]
    if frame.parentJoint != model.njoints - 1:
        raise RobotError(f"{origin}: link {tip!r} does not move with the last joint of the chain")
    return model, np.array(frame.placement.homogeneous)


def _normalized(root: ElementTree.Element) -> ElementTree.Element:
    """Return a copy that Pinocchio reads with one coordinate a joint and without geometry."""
    copy = ElementTree.fromstring(ElementTree.tostring(root))
    for link in copy.findall("link"):
        for element in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(element)
    for joint in copy.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
        if joint.get("type") not in MOVABLE:
            continue
        limit = joint.find("limit")
        if limit is None:
            limit = ElementTree.SubElement(joint, "limit")
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit.set("lower", str(-SAFETY_MARGIN))
            limit.set("upper", str(SAFETY_MARGIN))
        for name in ("effort", "velocity"):
            if limit.get(name) is None:
                limit.set(name, str(SAFETY_MARGIN))
    return copy


def _screws(
    model: Any, chain: list[UrdfJoint], elements: dict[str, ElementTree.Element], origin: str
) -> tuple[Joint, ...]:
    import pinocchio as pin

    data = model.createData()
    zero = np.zeros(model.nq)
    pin.computeJointJacobians(model, data, zero)
    joints = []
    for index, joint in enumerate(chain, start=1):
        jacobian = pin.getJointJacobian(model, data, index, pin.ReferenceFrame.WORLD)
        world = jacobian.reshape(6, -1)[:, index - 1]  # (6,) where there is one joint
        inertia = model.inertias[index]
        screw = np.concatenate([world[3:], world[:3]])
        joints.append(
            Joint(
                name=joint.name,
                screw=screw,
                home=np.array(data.oMi[index].homogeneous),
                limits=_limits(elements[joint.name], joint, origin),
                link=_link(inertia) if inertia.mass > 0.0 else None,
                link_name=joint.child,
            )
        )
    return tuple(joints)


def _link(inertia: Any) -> np.ndarray:
    """Return Pinocchio's dynamic parameters (10,), which are in our order already."""
    return np.array(inertia.toDynamicParameters())


def _limits(element: ElementTree.Element, joint: UrdfJoint, origin: str) -> Limits:
    limit = element.find("limit")
    if limit is None:
        return Limits()

    def stated(name: str) -> float:
        value = limit.get(name)
        if value is None:
            return NOT_STATED
        try:
            return float(value)
        except ValueError:
            raise RobotError(
                f"{origin}: joint {joint.name!r}: limit {name}={value!r} is not a number"
            ) from None

    continuous = joint.kind == "continuous"
    return Limits(
        position_lower=NOT_STATED if continuous else stated("lower"),
        position_upper=NOT_STATED if continuous else stated("upper"),
        velocity=stated("velocity") or NOT_STATED,
        acceleration=NOT_STATED,
        torque=stated("effort") or NOT_STATED,
    )
