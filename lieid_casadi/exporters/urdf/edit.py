"""Identified inertias and friction written into the URDF that a robot was read from."""

from __future__ import annotations

from lieid_casadi.exporters.joint_friction import SimulatorJoint, simulator_joints
from lieid_casadi.exporters.urdf.bodies import (
    InertiaSplit,
    inertial_text,
    members_of,
    number,
    split,
)
from lieid_casadi.exporters.xml_edit import Element, XmlText
from lieid_casadi.exporters.xml_text import attribute
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot import Joint


def edited_urdf(fit: Fit, text: str) -> tuple[str, list[str]]:
    """Return the URDF with a fit's link inertias and friction, and notes on what was done.

    All other characters stay as they are: only <inertial> of moving links, and damping and
    friction in <dynamics>, change.

    ``text``: the URDF that ``fit.model.robot`` was read from.
    """
    document, notes = XmlText(text), []
    links = {e.attributes.get("name", ""): e for e in document.root.children if e.tag == "link"}
    joints = {e.attributes.get("name", ""): e for e in document.root.children if e.tag == "joint"}
    chain = {joint.name for joint in fit.model.robot.joints}
    rigid = [element for name, element in joints.items() if name not in chain]
    bodies = fit.link_parameters.reshape(-1, 10)
    for joint, body, friction in zip(
        fit.model.robot.joints, bodies, simulator_joints(fit), strict=True
    ):
        shared = split(body, members_of(links, rigid, joint.link_name))
        document.replace_child(links[joint.link_name], "inertial", inertial_text(shared.own))
        if shared.share < 1.0:
            for member in shared.members:
                scaled = inertial_text(shared.share * member.nominal)
                document.replace_child(links[member.name], "inertial", scaled)
        notes += _notes_on_members(joint, shared)
        _write_friction(document, joints[joint.name], friction)
    notes += _meshes(document.root)
    return document.edited(), notes


def _notes_on_members(joint: Joint, shared: InertiaSplit) -> list[str]:
    if not shared.members:
        return []
    names = ", ".join(member.name for member in shared.members)
    moved = f"{names}: rigidly attached to {joint.link_name}"
    rest = f"{joint.link_name} has the rest"
    if shared.share == 1.0:
        return [f"{moved}; the nominal inertia is kept, {rest}"]
    return [
        f"{moved}; the nominal inertia exceeds the identified one and was scaled by "
        f"{shared.share:.3g}, {rest}"
    ]


def _write_friction(document: XmlText, joint: Element, friction: SimulatorJoint) -> None:
    new = {
        name: number(value)
        for name, value in (("damping", friction.damping), ("friction", friction.friction))
        if value is not None
    }
    if not new:
        return
    dynamics = joint.find("dynamics")
    attributes = (dynamics.attributes if dynamics is not None else {}) | new
    written = "".join(f" {name}={attribute(value)}" for name, value in attributes.items())
    document.replace_child(joint, "dynamics", f"<dynamics{written}/>")


def _meshes(root: Element) -> list[str]:
    """Return a note if paths of meshes are relative to the original file."""
    if any("://" not in path and not path.startswith("/") for path in _mesh_paths(root)):
        return ["mesh files are named relative to the folder of the original URDF"]
    return []


def _mesh_paths(element: Element) -> list[str]:
    own = [element.attributes["filename"]] if "filename" in element.attributes else []
    return own + [path for child in element.children for path in _mesh_paths(child)]
