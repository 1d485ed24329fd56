"""``lieid export FIT --to urdf``: the user's own URDF with the identified inertias."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.simulator_joints import (
    LinearFriction,
    armature,
    beyond_linear_friction,
    check_possible,
    file_name,
    has_friction,
    left_out,
    linear_friction,
    number,
    source_of,
)
from lieid_casadi.exporters.xml_text import Element, XmlText, attribute
from lieid_casadi.identification.feasible.certificate import position_range
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.uncertainty.covariance import EXACT, scaled_axes, square_root
from lieid_casadi.messages import joints_text
from lieid_casadi.robot import Joint, inertia
from lieid_casadi.robot.description import STANDARD_GRAVITY
from lieid_casadi.robot.urdf import RigidMember, rigid_members

SHARE = 0.5  # of the largest possible share, if the rigidly attached links cannot keep all
KEPT = 0.95  # below this fraction of the possible inertia they keep all
POSES = 200
UNCERTAIN = 0.5  # standard deviation of a joint's gravity load relative to it
LEAST_LOAD = 0.02  # of the largest: loads of other joints are not examined
LEAST_SHARE = 0.2  # of the gravity load of the robot's description
SEEN = 1e-6  # N·m per unit of a direction that the recordings did not excite


def urdf_files(fit: Fit, into: str | Path | None = None) -> tuple[dict[str, bytes], list[str]]:
    """Return ``ROBOT.urdf``, and notes on it.

    It is the one that the robot was read from, or ``into``, with the identified inertias and, where
    the model has them, viscous and Coulomb friction; everything else stays as it was.

    Raises `ExportError`: the fit's masses and inertias are not certified to be physically
    consistent (the message has the command that makes a fit whose are), the recordings did not
    show the gravity load of a joint, or there is no URDF to edit.
    """
    check_possible(fit)
    check_gravity(fit)
    text, notes = urdf_text(fit, into)
    return {f"{file_name(fit.model.robot.name)}.urdf": text.encode()}, notes


def check_gravity(fit: Fit) -> None:
    """Refuse a fit whose gravity load the recordings did not show: controllers compensate by it.

    That is a load, over random poses within the limits, whose standard deviation is above half of
    its size or that contains directions which the recordings did not excite; or one that is much
    smaller than that of the robot's description, as where the torque was gravity-compensated.
    """
    robot, n = fit.model.robot, fit.model.n
    q = np.random.default_rng(0).uniform(*position_range(robot), (POSES, n))
    rigid = fit.model.base.kept[fit.model.base.kept < 10 * n]
    columns = np.zeros((POSES, n, len(fit.values)))
    columns[:, :, : len(rigid)] = fit.compiled.regressor(q, 0.0 * q, 0.0 * q)[:, :, rigid]
    load = np.sqrt(np.mean((columns @ fit.values) ** 2, axis=0))
    p = len(fit.values)
    covariance = np.nan_to_num(fit.covariance[:p, :p])
    unit, variances, axes = scaled_axes(covariance)
    hidden = unit[:, None] * axes[:, variances < EXACT * float(variances[-1])]
    std = np.sqrt(np.mean(np.sum((columns @ square_root(covariance)) ** 2, axis=2), axis=0))
    unseen = np.any(np.abs(columns @ (hidden / np.linalg.norm(hidden, axis=0))) > SEEN, axis=(0, 2))
    loaded = load > LEAST_LOAD * float(load.max())
    doubtful = loaded & (unseen | (std > UNCERTAIN * load))
    if robot.has_inertia:
        stated = np.abs(fit.compiled.gravity(q, robot.link_parameters))
        stated = np.sqrt(np.mean(stated**2, axis=0))
        doubtful |= (load < LEAST_SHARE * stated) & (stated > LEAST_LOAD * float(stated.max()))
    if doubtful.any():
        j = int(np.argmax(doubtful * (1.0 + load)))
        raise ExportError(
            f"the recordings did not show the gravity load of {joints_text(doubtful)} (joint "
            f"{j + 1}: {load[j]:.3g} ± {std[j]:.2g} N·m over its range of positions): a URDF "
            "without it makes gravity compensation wrong; check the torque signal (lieid check), "
            "and identify from motion over more of the range"
        )


def urdf_text(fit: Fit, into: str | Path | None) -> tuple[str, list[str]]:
    """Return the URDF and notes on it; raises `ExportError` if there is none to edit."""
    robot, source = fit.model.robot, source_of(fit, into)
    friction = linear_friction(fit) if has_friction(fit) else ()
    if source is None or source.kind != "urdf":
        raise ExportError(
            f"{into or robot.name}: not a URDF; expected the arm's own URDF, into which the "
            "numbers are written (--into FILE, into=), or --to mjcf"
        )
    text, notes = edited_urdf(fit, source.text, friction)
    notes += beyond_linear_friction(friction)
    left = left_out(fit, friction=True)
    if any(armature(fit, j) is not None for j in range(robot.n)):
        notes.append("URDF has no element for armature; --to mjcf and --to isaaclab have it")
    if left:
        notes.append(f"not exported, because URDF has no element for it: {', '.join(left)}")
    if not np.allclose(robot.gravity, STANDARD_GRAVITY, atol=1e-9):
        x, y, z = robot.gravity
        notes.append(f"URDF has no element for gravity; set it to ({x:g}, {y:g}, {z:g}) m/s²")
    return text, notes


@dataclass(frozen=True, eq=False)
class InertiaSplit:
    """Link parameters of a joint's child link (10,), and the share that each member keeps."""

    own: Array
    share: float
    members: tuple[RigidMember, ...]


def split(identified: Array, members: Sequence[RigidMember]) -> InertiaSplit:
    """Return the distribution of an identified inertia (10,); each part is physically consistent.

    Members, which are rigidly attached to the joint's child link, keep their nominal inertia and
    the child link gets the rest. If the rest would not be physically consistent, masses and
    inertias of all members are scaled by one factor.
    """
    heavy = tuple(m for m in members if np.any(m.nominal != 0.0))
    carried = np.zeros(10)
    for member in heavy:
        carried += inertia.parameter_transport(member.placement) @ member.nominal
    root = np.linalg.inv(np.linalg.cholesky(inertia.pseudo_inertia(identified)))
    largest = float(np.linalg.eigvalsh(root @ inertia.pseudo_inertia(carried) @ root.T)[-1])
    share = 1.0 if largest < KEPT else SHARE / largest
    return InertiaSplit(identified - share * carried, share, heavy)


def named(root: Element, tag: str) -> dict[str, Element]:
    """Return the elements of a tag below the root by their names."""
    return {e.attributes.get("name", ""): e for e in root.children if e.tag == tag}


def inertial_text(parameters: Array) -> str:
    """Return an <inertial> element of link parameters (10,), with all their digits."""
    body = inertia.body_inertia(parameters)
    i = body.inertia
    com = " ".join(number(x) for x in body.com)
    return (
        "<inertial>\n"
        f'  <origin xyz="{com}" rpy="0 0 0"/>\n'
        f'  <mass value="{number(body.mass)}"/>\n'
        f'  <inertia ixx="{number(i[0, 0])}" ixy="{number(i[0, 1])}" ixz="{number(i[0, 2])}"'
        f' iyy="{number(i[1, 1])}" iyz="{number(i[1, 2])}" izz="{number(i[2, 2])}"/>\n'
        "</inertial>"
    )


def edited_urdf(fit: Fit, text: str, friction: Sequence[LinearFriction]) -> tuple[str, list[str]]:
    """Return a URDF with link inertias and, where given, the joints' friction, and notes.

    All other characters stay as they are: only <inertial> of moving links, and damping and
    friction in <dynamics>, change.
    """
    document, notes = XmlText(text), []
    links, joints = (named(document.root, tag) for tag in ("link", "joint"))
    bodies, rigid = fit.link_parameters.reshape(-1, 10), rigid_members(text, fit.model.robot.joints)
    for j, joint in enumerate(fit.model.robot.joints):
        shared = split(bodies[j], rigid[j])
        document.replace_child(links[joint.link_name], "inertial", inertial_text(shared.own))
        if shared.share < 1.0:
            for member in shared.members:
                scaled = inertial_text(shared.share * member.nominal)
                document.replace_child(links[member.name], "inertial", scaled)
        notes += _notes_on_members(joint, shared)
        if friction:
            _write_friction(document, joints[joint.name], friction[j])
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


def _write_friction(document: XmlText, joint: Element, friction: LinearFriction) -> None:
    new = {"damping": number(friction.damping), "friction": number(friction.loss)}
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
