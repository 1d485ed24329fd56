"""Identified inertias and friction written into the URDF that a robot was read from."""

from __future__ import annotations

from lieid_casadi.exporters.joint_friction import JointFriction, joint_frictions
from lieid_casadi.exporters.urdf_bodies import (
    Split,
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

    Every character stands as it was, but for <inertial> of the links that move and damping and
    friction in <dynamics>.

    Parameters
    ----------
    text : str
        The URDF that ``fit.model.robot`` was read from.
    """
    document, notes = XmlText(text), []
    links = {e.attributes.get("name", ""): e for e in document.root.children if e.tag == "link"}
    joints = {e.attributes.get("name", ""): e for e in document.root.children if e.tag == "joint"}
    chain = {joint.name for joint in fit.model.robot.joints}
    rigid = [element for name, element in joints.items() if name not in chain]
    bodies = fit.link_parameters.reshape(-1, 10)
    for joint, body, friction in zip(
        fit.model.robot.joints, bodies, joint_frictions(fit), strict=True
    ):
        shared = split(body, members_of(links, rigid, joint.link_name))
        document.replace_child(links[joint.link_name], "inertial", inertial_text(shared.own))
        if shared.share < 1.0:
            for member in shared.members:
                scaled = inertial_text(shared.share * member.nominal)
                document.replace_child(links[member.name], "inertial", scaled)
        notes += _told(joint, shared)
        _write_friction(document, joints[joint.name], friction)
    notes += _meshes(document.root)
    return document.edited(), notes


def _told(joint: Joint, shared: Split) -> list[str]:
    if not shared.members:
        return []
    names = ", ".join(member.name for member in shared.members)
    moved = f"{names}: moved by {joint.name} with {joint.link_name}"
    rest = f"{joint.link_name} has the rest"
    if shared.share == 1.0:
        return [f"{moved}, own inertia kept; {rest}"]
    return [
        f"{moved}, nominally heavier than all that was identified there; scaled by "
        f"{shared.share:.3g}; {rest}"
    ]


def _write_friction(document: XmlText, joint: Element, friction: JointFriction) -> None:
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
    """Tell mesh paths that stand relative to the original file."""
    if any("://" not in path and not path.startswith("/") for path in _mesh_paths(root)):
        return ["mesh files are named relative to the folder of the original URDF"]
    return []


def _mesh_paths(element: Element) -> list[str]:
    own = [element.attributes["filename"]] if "filename" in element.attributes else []
    return own + [path for child in element.children for path in _mesh_paths(child)]
