"""The kinematic tree of a URDF, and the chain of joints that an arm is made of."""

from __future__ import annotations

from collections.abc import Sequence

from lieid_casadi.errors import RobotError
from lieid_casadi.robot.urdf_elements import UrdfJoint


def check_tree(
    joints: Sequence[UrdfJoint], links: Sequence[str], origin: str
) -> dict[str, UrdfJoint]:
    """Return the joint that carries each link but the root.

    Parameters
    ----------
    joints : sequence of UrdfJoint
    links : sequence of str
        Names of all links.
    origin : str
        Named in errors.

    Raises
    ------
    RobotError
        An unknown link, a loop, more than one root.
    """
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
    """Return the joints from the root to a link.

    Parameters
    ----------
    link : str
    parents : dict
        Link → the joint above it.
    origin : str
        Name of the file, for error messages.
    """
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
    """Return the movable joints from the root to the tip that are not locked.

    Parameters
    ----------
    joints : sequence of UrdfJoint
    parents : mapping
        Link → the joint that carries it.
    tip : str or None
        Last link; None if all joints that are not locked form one chain.
    lock : sequence of str
        Joints that do not move.
    origin : str
        Named in errors.

    Raises
    ------
    RobotError
        An unknown tip or joint, branches without a tip, no joint, a joint that mimics another.
    """
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
    for joint in chain:
        if joint.mimics:
            raise RobotError(
                f"{origin}: joint {joint.name!r} mimics {joint.mimics!r}; expected independent "
                f"joints: lock it (--lock {joint.name}) or remove <mimic>"
            )
    return chain


def tip_link(joints: Sequence[UrdfJoint], chain: Sequence[UrdfJoint], tip: str | None) -> str:
    """Return the tip; if none is given, the last of the fixed links after the chain.

    Parameters
    ----------
    joints, chain : sequence of UrdfJoint
        All joints, and those of the arm.
    tip : str or None
    """
    if tip is not None:
        return tip
    link = chain[-1].child
    while True:
        following = [j.child for j in joints if j.parent == link and j.kind == "fixed"]
        if len(following) != 1:
            return link
        link = following[0]
