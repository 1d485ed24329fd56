"""Distribution of the identified inertia of a joint over the URDF links that move with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.exporters.xml_edit import Element
from lieid_casadi.robot.geometry import pose
from lieid_casadi.robot.inertia import (
    body_inertia,
    link_parameters,
    parameter_transport,
    pseudo_inertia,
    symmetric,
)

SHARE = 0.5  # of the largest possible share, if the rigidly attached links cannot keep all
KEPT = 0.95  # below this fraction of the possible inertia they keep all


@dataclass(frozen=True, eq=False)
class RigidMember:
    """A link that is rigidly attached to the child link of a joint.

    ``placement`` (4, 4) is its frame in the frame of the joint's child link; ``nominal`` (10,)
    its link parameters in its own frame.
    """

    name: str
    placement: Array
    nominal: Array


@dataclass(frozen=True, eq=False)
class InertiaSplit:
    """Link parameters of a joint's child link (10,), and the share that each member keeps."""

    own: Array
    share: float
    members: tuple[RigidMember, ...]


def split(identified: Array, members: Sequence[RigidMember]) -> InertiaSplit:
    """Return the distribution of an identified inertia; each part is physically consistent.

    Members keep their nominal inertia and the child link gets the rest. If the rest would not be
    physically consistent, masses and inertias of all members are scaled by one factor.

    ``identified`` (10,): link parameters in the frame of the joint's child link, positive definite;
    ``members``: links that are rigidly attached to the child link.
    """
    heavy = tuple(m for m in members if np.any(m.nominal != 0.0))
    carried = np.zeros(10)
    for member in heavy:
        carried += parameter_transport(member.placement) @ member.nominal
    root = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(identified)))
    largest = float(np.linalg.eigvalsh(root @ pseudo_inertia(carried) @ root.T)[-1])
    share = 1.0 if largest < KEPT else SHARE / largest
    return InertiaSplit(identified - share * carried, share, heavy)


def members_of(
    links: dict[str, Element], joints: Sequence[Element], child: str
) -> list[RigidMember]:
    """Return the links attached to a link by joints that are rigid in the model, held at zero.

    ``links``: name → element; ``joints``: joints that are not part of the chain; ``child``: name of
    the link.
    """
    found: list[RigidMember] = []
    places = {child: np.eye(4)}
    waiting = [child]
    while waiting:
        parent = waiting.pop()
        for joint in joints:
            if _link_of(joint, "parent") != parent:
                continue
            name = _link_of(joint, "child")
            places[name] = places[parent] @ origin_of(joint)
            found.append(RigidMember(name, places[name], stated_parameters(links[name])))
            waiting.append(name)
    return found


def stated_parameters(link: Element) -> Array:
    """Return the link parameters (10,) that a <link> states, zeros if none."""
    inertial = link.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    if inertial is None or mass is None:
        return np.zeros(10)
    place = origin_of(inertial)
    stated = inertial.find("inertia")
    keys = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
    six = [0.0 if stated is None else float(stated.attributes.get(key, "0")) for key in keys]
    turned = place[:3, :3] @ symmetric(six) @ place[:3, :3].T
    return link_parameters(float(mass.attributes.get("value", "0")), place[:3, 3], turned)


def origin_of(element: Element) -> Array:
    """Return the pose (4, 4) of an element's <origin>."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    return pose(
        [float(x) for x in origin.attributes.get("xyz", "0 0 0").split()],
        [float(x) for x in origin.attributes.get("rpy", "0 0 0").split()],
    )


def inertial_text(parameters: Array) -> str:
    """Return an <inertial> element of link parameters (10,), with all their digits."""
    body = body_inertia(parameters)
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


def number(value: float) -> str:
    """Return a number that reads back the same."""
    return repr(float(value) + 0.0)


def _link_of(joint: Element, tag: str) -> str:
    end = joint.find(tag)
    return "" if end is None else end.attributes.get("link", "")
