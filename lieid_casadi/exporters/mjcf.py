"""A fit as a MuJoCo model: kinematics, identified inertias, joint friction and actuators."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExportError, NotReadWarning
from lieid_casadi.exporters.mjcf_in_place import CannotEdit, edited_mjcf
from lieid_casadi.exporters.simulator_joints import (
    ActuatorLaw,
    LinearFriction,
    PassiveTorques,
    actuator_law,
    beyond_linear_friction,
    check_possible,
    file_name,
    for_steps,
    inertial,
    left_out,
    linear_friction,
    number,
    passive_torques,
    source_of,
    vector,
)
from lieid_casadi.exporters.xml_text import allowed, comment
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot import Joint
from lieid_casadi.simulation.play import Play, plays_of

Element = ElementTree.Element
STEP, INTEGRATOR = 0.002, "implicitfast"  # s
#: solreflimit of a play: the sides' time constant, s, the shortest that MuJoCo integrates stably
#: with its step, and damping relative to critical damping.
SIDES = (2.0 * STEP, 1.0)
HEAD = """
     {robot}, identified by lieid-casadi {version} (method {method}) from {recordings}.
     Joints and actuators are in the robot's order. ctrl: {control}.
{notes}"""
#: Effects that MuJoCo has itself.
EXPRESSED = frozenset(
    ("armature", "command_delay", "coulomb", "offset", "position_spring", "torque_saturation",
     "viscous")
)  # fmt: skip


def mjcf_files(fit: Fit, into: str | Path | None = None) -> tuple[dict[str, bytes], list[str]]:
    """Return the files of a MuJoCo model by their names, and notes on its approximations.

    That of a robot from a MuJoCo model is that model, or ``into``, with the numbers of the fit in
    place (`mjcf_in_place`); that of others, ``ROBOT.xml``, is written from screws.

    Raises `ExportError`: the fit's masses and inertias are not certified to be physically
    consistent; the message has the command that makes a fit whose are.
    """
    check_possible(fit)
    source, why = source_of(fit, into), list[str]()
    if source is not None and source.kind == "mjcf":
        try:
            friction = linear_friction(fit)
            files, notes = edited_mjcf(fit, source, friction)
            notes = [*notes_of(fit, friction, ()), *notes]
            unread = (w for w in fit.warnings if isinstance(w, NotReadWarning))
            notes += [f"the model keeps what is not part of the fit ({w})" for w in unread]
            return {name: text.encode() for name, text in files.items()}, notes
        except CannotEdit as reason:
            if into is not None:
                raise
            why = [f"written anew, without the rest of the robot's own model, because {reason}"]
    if into is not None:
        raise ExportError(f"{into}: not a MuJoCo model")
    text, notes = mjcf_text(fit)
    return {f"{file_name(fit.model.robot.name)}.xml": text.encode()}, [*why, *notes]


def notes_of(fit: Fit, friction: Sequence[LinearFriction], plays: Sequence[Play]) -> list[str]:
    """Return notes on what a model with given plays approximates and leaves out."""
    robot = fit.model.robot
    notes: list[str] = []
    names = {p.effect.name for p in fit.model.placements}
    notes += beyond_linear_friction(friction)
    rigid = {p.joint for p in fit.model.placements if p.effect.name == "backlash"}
    rigid -= {play.joint for play in plays}
    expressed = EXPRESSED | (set() if rigid else {"backlash"})
    left = sorted(left_out(fit, friction=True, besides=expressed))
    notes.extend(
        f"joint {play.joint + 1}: a play of {play.width:.4g} rad is the joint NAME_play beside "
        "joint NAME, which is the motor's; qpos and qvel contain both"
        for play in plays
    )
    if left:
        notes.append(f"not part of the MuJoCo model: {', '.join(left)}")
    if "armature" in names and robot.drives:
        notes.append(
            "armature is that of the fit less half of a time step × damping, which MuJoCo's "
            "integration adds to the inertia, and delays are longer by half of a time step; "
            "export again for another timestep or integrator"
        )
    if "command_delay" in names:
        notes.append(
            "command delays are attributes of the actuators, which MuJoCo 4.0 has; if ctrl is held "
            "for an interval between commands, as in the recordings, subtract half of it"
        )
    relative = [drive for drive in robot.drives or () if drive.relative]
    if relative:
        notes.append(
            "the drive stiffness K is unknown: masses, inertias and torques are divided by it, "
            "and kp is 1; motion under commands is the same, forces are not in N"
        )
    return notes


def mjcf_text(fit: Fit, *, step: float = STEP) -> tuple[str, list[str]]:
    """Return a MuJoCo model that is integrated in steps (s), and notes on its approximations.

    Raises `ExportError`: a number that is not finite.
    """
    from lieid_casadi import __version__

    robot = fit.model.robot
    if not np.all(np.isfinite(fit.parameters)):
        raise ExportError("a parameter of the fit is not finite; fit again")
    friction = linear_friction(fit)
    root = ElementTree.Element("mujoco", model=allowed(robot.name) or "robot")
    _add(root, "compiler", angle="radian", autolimits="true")
    gravity = vector(robot.gravity)
    _add(root, "option", timestep=number(step), integrator=INTEGRATOR, gravity=gravity)
    world = _add(root, "worldbody")
    parent, before = world, np.eye(4)
    names = _unique([joint.link_name or f"{joint.name}_link" for joint in robot.joints])
    joints = _unique([joint.name for joint in robot.joints])
    plays = {play.joint: play.width for play in plays_of(fit)}
    bodies, laws = fit.link_parameters.reshape(-1, 10), list[ActuatorLaw | None]()
    for j, joint in enumerate(robot.joints):
        place = np.asarray(np.linalg.solve(before, joint.home))
        _add_link(parent, place, j)
        parent = _add(parent, "body", name=names[j], **_pose(place))
        _add(parent, "inertial", **inertial(bodies[j]))
        law, passive = actuator_law(fit, j), passive_torques(fit, j, friction[j])
        passive, law = for_steps(passive, law, step, INTEGRATOR)
        laws.append(law)
        _add_joint(parent, joint, joints[j], passive)
        if j in plays:
            _add_play(parent, joint, f"{joints[j]}_play", plays[j])
        before = joint.home
    _add_link(parent, robot.tool, robot.n)
    _add(parent, "site", name="tool", **_pose(robot.tool))
    actuators = _add(root, "actuator")
    for j, joint in enumerate(robot.joints):
        _add_actuator(actuators, joint, joints[j], laws[j])
    notes = notes_of(fit, friction, plays_of(fit))
    if robot.drives is None and any(np.isnan(robot.limit("torque"))):
        notes.append("no torque limits are stated: the range of the motors is not limited")
    ElementTree.indent(root)
    head = HEAD.format(
        robot=comment(robot.name),
        version=__version__,
        method=fit.method,
        recordings=comment(", ".join(s.name for s in fit.provenance.recordings)) or "no recording",
        control="commanded position, rad" if robot.drives else "torque, N·m",
        notes="".join(f"     {comment(note)}\n" for note in notes),
    )
    body = ElementTree.tostring(root, encoding="unicode")
    return f"<!--{head}-->\n{body}\n", notes


def _add(parent: Element, tag: str, **attributes: str) -> Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _add_link(parent: Element, place: Array, index: int) -> None:
    """Draw a link from its origin to the next one; it neither weighs nor collides."""
    length = float(np.linalg.norm(place[:3, 3]))
    if index and length > 1e-3:
        _add(
            parent, "geom", type="capsule", size=number(0.12 * length), mass="0",
            contype="0", conaffinity="0", rgba="0.6 0.65 0.7 1",
            fromto=vector(np.concatenate([np.zeros(3), place[:3, 3]])),
        )  # fmt: skip


def _add_joint(parent: Element, joint: Joint, name: str, passive: PassiveTorques) -> None:
    """Add a joint with its passive torques."""
    attributes = {"name": name, **_axis(joint)}
    limits = joint.limits
    if math.isfinite(limits.position_lower) and math.isfinite(limits.position_upper):
        attributes["range"] = vector([limits.position_lower, limits.position_upper])
    stated = {key: value for key, value in vars(passive).items() if value}
    attributes |= {key: vector(np.atleast_1d(value)) for key, value in stated.items()}
    _add(parent, "joint", **attributes)


def _add_play(parent: Element, joint: Joint, name: str, width: float) -> None:
    """Add the angle of a link relative to its motor: a joint beside the actuated one.

    The armature of the actuated joint is then the inertia of the motor alone.
    """
    sides = {"range": vector([-0.5 * width, 0.5 * width]), "solreflimit": vector(SIDES)}
    _add(parent, "joint", name=name, **_axis(joint), **sides)


def _axis(joint: Joint) -> dict[str, str]:
    """Return type, axis and position of a joint in its link's frame."""
    omega, v = joint.axis[:3], joint.axis[3:]
    if not joint.revolute:
        return {"type": "slide", "axis": vector(v)}
    return {"type": "hinge", "axis": vector(omega), "pos": vector(np.cross(omega, v))}


def _add_actuator(parent: Element, joint: Joint, name: str, law: ActuatorLaw | None) -> None:
    """Add a position actuator with the gains of the drive, or a motor."""
    limit = joint.limits.torque
    attributes = {"name": name, "joint": name}
    if law is None:
        if math.isfinite(limit):
            attributes["ctrlrange"] = vector([-limit, limit])
        _add(parent, "motor", **attributes)
        return
    attributes["kp"] = number(law.stiffness)
    if law.damping:
        attributes["kv"] = number(law.damping)
    if law.delay > 0.0:
        samples = math.ceil(law.delay / STEP) + 1
        attributes |= {"delay": number(law.delay), "nsample": str(samples)}
    if math.isfinite(law.force):
        attributes["forcerange"] = vector([-law.force, law.force])
    _add(parent, "position", **attributes)


def _unique(names: Sequence[str]) -> list[str]:
    """Return names that are not empty and occur once."""
    made: list[str] = []
    for k, name in enumerate(allowed(name) for name in names):
        made.append(name if name and name not in made else f"{name}_{k + 1}")
    return made


def _pose(place: Array) -> dict[str, str]:
    """Return position and quaternion [w x y z] of a pose (4, 4)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(place[:3, :3]).as_quat()
    return {"pos": vector(place[:3, 3]), "quat": vector([w, x, y, z])}
