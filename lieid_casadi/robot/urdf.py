"""A serial arm from a URDF, whose kinematic tree Pinocchio evaluates."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Any
from xml.etree import ElementTree

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import LieidWarning, MimicJointWarning, NominalInertiaWarning, RobotError
from lieid_casadi.messages import reason_of
from lieid_casadi.robot.description import MOST_JOINTS, Joint, RobotDescription, RobotSource
from lieid_casadi.robot.inertia import impossible_moments, pose
from lieid_casadi.robot.urdf_elements import INERTIA, UrdfJoint, UrdfLink, read_elements

WIDE = "1e6"  # for limits that Pinocchio requires; the stated limits are read separately


def read_urdf(
    text: str, *, tip: str | None = None, lock: Sequence[str] = (), origin: str = "URDF"
) -> RobotDescription:
    """Return the serial arm that a URDF describes.

    The chain runs from the root link to ``tip``. Joints in ``lock``, and joints on branches
    off the chain, are locked at zero and their links lumped into the link that carries them,
    as in Pinocchio's reduced model. Meshes are not read.
    """
    root = _xml(text, origin)
    links, joints = read_elements(root, origin)
    parents = check_tree(joints, [link.name for link in links], origin)
    chain = serial_chain(joints, parents, tip=tip, lock=lock, origin=origin)
    last = tip_link(joints, chain, tip)
    model, tool = _reduced_model(links, joints, chain, last, origin)
    return RobotDescription(
        name=root.get("name") or "robot",
        joints=_joints(model, chain),
        gravity=np.array(model.gravity.linear),
        tool=tool,
        source=RobotSource("urdf", text, tip, tuple(lock)),
        warnings=(*_inertia_warnings(links, origin), *_mimic_warnings(joints, origin)),
        tool_name=last,
    )


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


def _mimic_warnings(joints: Sequence[UrdfJoint], origin: str) -> Iterator[LieidWarning]:
    """Yield warnings of joints that follow others; in the chain they are refused before."""
    for joint in joints:
        if joint.mimics and joint.movable:
            yield MimicJointWarning(
                f"{origin}: joint {joint.name!r} mimics {joint.mimics!r}, which is not modelled: "
                "it is kept at zero"
            )


def _inertia_warnings(links: Sequence[UrdfLink], origin: str) -> Iterator[LieidWarning]:
    for link in links:
        xx, xy, xz, yy, yz, zz = link.inertia
        if (fault := impossible_moments([0.0, 0.0, 0.0, 0.0, xx, xy, yy, xz, yz, zz])) is not None:
            yield NominalInertiaWarning(
                f"{origin}: link {link.name!r}: its inertia has {fault} which is physically "
                "impossible"
            )


def _reduced_model(
    links: Sequence[UrdfLink],
    joints: Sequence[UrdfJoint],
    chain: Sequence[UrdfJoint],
    tip: str,
    origin: str,
) -> tuple[Any, Array]:
    """Return Pinocchio's model of the chain alone and the tip's pose (4, 4) in the last link."""
    import pinocchio as pin

    numbers = {link.name: k for k, link in enumerate(links)}
    try:
        with silenced():
            full = pin.buildModelFromXML(_numbered_urdf(numbers, links, joints))
    except (ValueError, RuntimeError) as error:
        raise RobotError(f"{origin}: Pinocchio cannot read it: {reason_of(error)}") from None
    kept = {joint.name for joint in chain}
    locked = [
        full.getJointId(f"joint{k}")
        for k, joint in enumerate(joints)
        if joint.movable and joint.name not in kept
    ]
    model = pin.buildReducedModel(full, locked, np.zeros(full.nq))
    frame = model.frames[model.getFrameId(f"link{numbers[tip]}", pin.FrameType.BODY)]
    if frame.parentJoint != model.njoints - 1:
        raise RobotError(f"{origin}: link {tip!r} does not move with the last joint of the chain")
    return model, np.array(frame.placement.homogeneous)


def _numbered_urdf(
    numbers: dict[str, int], links: Sequence[UrdfLink], joints: Sequence[UrdfJoint]
) -> str:
    """Return a URDF of the checked numbers alone, elements named by their numbers."""
    root = ElementTree.Element("robot", name="robot")
    for k, link in enumerate(links):
        element = ElementTree.SubElement(root, "link", name=f"link{k}")
        if link.mass > 0.0 or link.inertia.any():
            inertial = ElementTree.SubElement(element, "inertial")
            _add_pose(inertial, link.com_xyz, link.com_rpy)
            ElementTree.SubElement(inertial, "mass", value=repr(link.mass))
            six = {name: repr(float(x)) for name, x in zip(INERTIA, link.inertia, strict=True)}
            ElementTree.SubElement(inertial, "inertia", six)
    for k, joint in enumerate(joints):
        kind = "revolute" if joint.kind == "continuous" else joint.kind
        element = ElementTree.SubElement(root, "joint", name=f"joint{k}", type=kind)
        _add_pose(element, joint.xyz, joint.rpy)
        ElementTree.SubElement(element, "parent", link=f"link{numbers[joint.parent]}")
        ElementTree.SubElement(element, "child", link=f"link{numbers[joint.child]}")
        if joint.movable:
            ElementTree.SubElement(element, "axis", xyz=_text(joint.axis))
            wide = {"lower": f"-{WIDE}", "upper": WIDE, "effort": WIDE, "velocity": WIDE}
            ElementTree.SubElement(element, "limit", wide)
    return ElementTree.tostring(root, encoding="unicode")


def _add_pose(element: ElementTree.Element, xyz: Array, rpy: Array) -> None:
    ElementTree.SubElement(element, "origin", xyz=_text(xyz), rpy=_text(rpy))


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _joints(model: Any, chain: Sequence[UrdfJoint]) -> tuple[Joint, ...]:
    import pinocchio as pin

    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(model.nq))
    joints = []
    for index, joint in enumerate(chain, start=1):
        jacobian = pin.getJointJacobian(model, data, index, pin.ReferenceFrame.WORLD)
        world = jacobian.reshape(6, -1)[:, index - 1]  # (6,) if there is one joint
        inertia = model.inertias[index]
        joints.append(
            Joint(
                name=joint.name,
                screw=np.concatenate([world[3:], world[:3]]),
                home=np.array(data.oMi[index].homogeneous),
                limits=joint.limits,
                # in the order of `lieid_casadi.robot.inertia`
                link=np.array(inertia.toDynamicParameters()) if inertia.mass > 0.0 else None,
                link_name=joint.child,
            )
        )
    return tuple(joints)


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
    free = {joint.name: joint for joint in movable if joint.name not in lock}

    def chain_to(link: str) -> list[UrdfJoint]:
        return [joint for joint in path_to_root(link, parents, origin) if joint.name in free]

    if tip is not None:
        chain = chain_to(tip)
    else:
        chain = max((chain_to(joint.child) for joint in free.values()), key=len, default=[])
        inside = {joint.name for joint in chain}
        branch = [name for name in free if name not in inside]
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


@dataclass(frozen=True, eq=False)
class RigidMember:
    """A link that is rigidly attached to a joint's child link: frame (4, 4) there, parameters."""

    name: str
    placement: Array
    nominal: Array


def rigid_members(text: str, chain: Sequence[Joint]) -> list[list[RigidMember]]:
    """Return the links attached to each link of a URDF's chain by joints that are held at zero."""
    links, joints = read_elements(_xml(text, "URDF"), "URDF")
    nominal = {link.name: link.parameters for link in links}
    held = [j for j in joints if j.name not in {own.name for own in chain}]
    found: list[list[RigidMember]] = []
    for link in (own.link_name for own in chain):
        members, waiting = list[RigidMember](), [(link, np.eye(4))]
        while waiting:
            parent, place = waiting.pop()
            for joint in (j for j in held if j.parent == parent):
                below = place @ pose(joint.xyz, joint.rpy)
                members.append(RigidMember(joint.child, below, nominal[joint.child]))
                waiting.append((joint.child, below))
        found.append(members)
    return found


_lock = Lock()  # the descriptors belong to the process


@contextmanager
def silenced() -> Iterator[None]:
    """Discard what a native library writes to the file descriptors 1 and 2 of the process."""
    with _lock, open(os.devnull, "wb") as nowhere, ExitStack() as restore:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        for descriptor in (1, 2):
            try:
                copy = os.dup(descriptor)
            except OSError:  # closed, as in a service without a terminal
                continue
            restore.callback(os.close, copy)
            restore.callback(os.dup2, copy, descriptor)
            os.dup2(nowhere.fileno(), descriptor)
        yield
