"""A serial arm from a URDF, whose kinematic tree Pinocchio evaluates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import (
    LieidWarning,
    MimicJointWarning,
    NominalInertiaWarning,
    RobotError,
)
from lieid_casadi.robot.inertia import impossible_moments
from lieid_casadi.robot.joint import Joint, RobotDescription, RobotSource
from lieid_casadi.robot.native_output import captured
from lieid_casadi.robot.urdf_elements import INERTIA, UrdfJoint, UrdfLink, read_elements
from lieid_casadi.robot.urdf_tree import check_tree, serial_chain, tip_link

Array = NDArray[np.float64]
WIDE = "1e6"  # for limits that Pinocchio requires; the stated limits are read separately


def read_urdf(
    text: str, *, tip: str | None = None, lock: Sequence[str] = (), origin: str = "URDF"
) -> RobotDescription:
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
        Named in errors, such as the file's path.

    Raises
    ------
    RobotError
        Not XML, a loop, a floating or planar joint, an ambiguous chain, unknown names, or a
        number that cannot be used, with the name of its link or joint.
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
        xx, xy, xz, yy, yz, zz = link.inertia
        central = [0.0, 0.0, 0.0, 0.0, xx, xy, yy, xz, yz, zz]
        fault = impossible_moments(central)
        if fault is not None:
            warnings.append(
                NominalInertiaWarning(
                    f"{origin}: link {link.name!r}: its inertia has {fault} which is physically "
                    "impossible"
                )
            )
    return warnings


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
    with captured() as output:
        try:
            full = pin.buildModelFromXML(_numbered_urdf(numbers, links, joints))
        except (ValueError, RuntimeError) as error:
            reason = " ".join(f"{error} {output.text}".split())[:200]
            raise RobotError(f"{origin}: Pinocchio cannot read it: {reason}") from None
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
    """Return a URDF of the checked numbers alone, elements named by their numbers.

    Each movable joint has one coordinate, and no name can clash with one of Pinocchio's.
    """
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
