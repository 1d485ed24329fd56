"""A fit as a MuJoCo model: written into the user's own model, or made from screws.

In the user's own model everything but inertials, passive torques of joints and actuators stays as
it is, character by character: default classes, names, geoms, sites, cameras, sensors, keyframes,
comments. Attributes are written onto the elements themselves, and only where they differ from what
the file and its default classes state.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExportError, NotReadWarning
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
from lieid_casadi.exporters.urdf import split
from lieid_casadi.exporters.xml_text import Element, XmlText, allowed, comment
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot import Joint
from lieid_casadi.robot.description import RobotSource
from lieid_casadi.robot.urdf import RigidMember
from lieid_casadi.simulation.step import Play, plays_of

Node = ElementTree.Element
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
    place (`edited_mjcf`); that of others, ``ROBOT.xml``, is written from screws.

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
    if any(drive.relative for drive in robot.drives or ()):
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
    root = Node("mujoco", model=allowed(robot.name) or "robot")
    _add(root, "compiler", angle="radian", autolimits="true")
    gravity = vector(robot.gravity)
    _add(root, "option", timestep=number(step), integrator=INTEGRATOR, gravity=gravity)
    parent, before = _add(root, "worldbody"), np.eye(4)
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
            # the armature of the actuated joint is then the inertia of the motor alone
            reach = 0.5 * plays[j]
            sides = {"range": vector([-reach, reach]), "solreflimit": vector(SIDES)}
            _add(parent, "joint", name=f"{joints[j]}_play", **_axis(joint), **sides)
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


def _add(parent: Node, tag: str, **attributes: str) -> Node:
    return ElementTree.SubElement(parent, tag, attributes)


def _add_link(parent: Node, place: Array, index: int) -> None:
    """Draw a link from its origin to the next one; it neither weighs nor collides."""
    length = float(np.linalg.norm(place[:3, 3]))
    if index and length > 1e-3:
        _add(
            parent, "geom", type="capsule", size=number(0.12 * length), mass="0",
            contype="0", conaffinity="0", rgba="0.6 0.65 0.7 1",
            fromto=vector(np.concatenate([np.zeros(3), place[:3, 3]])),
        )  # fmt: skip


def _add_joint(parent: Node, joint: Joint, name: str, passive: PassiveTorques) -> None:
    """Add a joint with its passive torques."""
    attributes = {"name": name, **_axis(joint)}
    limits = joint.limits
    if math.isfinite(limits.position_lower) and math.isfinite(limits.position_upper):
        attributes["range"] = vector([limits.position_lower, limits.position_upper])
    stated = {key: value for key, value in vars(passive).items() if value}
    attributes |= {key: vector(np.atleast_1d(value)) for key, value in stated.items()}
    _add(parent, "joint", **attributes)


def _axis(joint: Joint) -> dict[str, str]:
    """Return type, axis and position of a joint in its link's frame."""
    omega, v = joint.axis[:3], joint.axis[3:]
    if not joint.revolute:
        return {"type": "slide", "axis": vector(v)}
    return {"type": "hinge", "axis": vector(omega), "pos": vector(np.cross(omega, v))}


def _add_actuator(parent: Node, joint: Joint, name: str, law: ActuatorLaw | None) -> None:
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


TIMESTEP = 0.002  # s, MuJoCo's default
ACTUATORS = frozenset(
    ("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle",
     "adhesion")
)  # fmt: skip
WHOLE = {"inertiafromgeom": "true", "balanceinertia": "true"}  # settings that change inertials


@dataclass(frozen=True, eq=False)
class _Place:
    """An element, the file that it is in, the class that its children inherit, and its body."""

    element: Element
    file: str
    inherited: str
    body: Element | None

    def get(self, name: str, default: str = "") -> str:
        """Return an attribute of the element itself."""
        return self.element.attributes.get(name, default)


class CannotEdit(ExportError):
    """The model is not one that can be edited in place; the message says why."""


def edited_mjcf(
    fit: Fit, source: RobotSource, friction: Sequence[LinearFriction]
) -> tuple[dict[str, str], list[str]]:
    """Return the files of the user's model with the numbers of a fit, and notes.

    Raises `CannotEdit`: bodies without names, or settings by which MuJoCo changes inertials.
    """
    model = _Model(source)
    notes: list[str] = []
    bodies = fit.link_parameters.reshape(-1, 10)
    for j, joint in enumerate(fit.model.robot.joints):
        body, carried = source.carried[j]
        shared = split(bodies[j], [RigidMember("branches", np.eye(4), np.array(carried))])
        notes += model.write_inertials(body, shared.own, shared.share)
        law, passive = actuator_law(fit, j), passive_torques(fit, j, friction[j])
        passive, law = for_steps(passive, law, model.timestep, model.integrator)
        moved = model.write_joint(body, joint.name, passive)
        notes += model.write_actuator(moved, joint.name, law)
    if not np.allclose(model.gravity, fit.model.robot.gravity, atol=1e-9):
        x, y, z = fit.model.robot.gravity
        notes.append(f"gravity is not changed; the fit is for ({x:g}, {y:g}, {z:g}) m/s²")
    return {name: text.edited() for name, text in model.texts.items()}, notes


class _Model:
    """The files of a model, and edits of its elements."""

    def __init__(self, source: RobotSource) -> None:
        self._links = {body for body, _ in source.carried}
        names = [PurePosixPath(name) for name, _ in source.files]
        if any(name.is_absolute() or ".." in name.parts for name in names):
            raise CannotEdit("it includes files outside of its folder")
        self.texts = {name: XmlText(text) for name, text in source.files}
        self._main = source.files[0][0]
        root = self.texts[self._main].root
        self._places = list(self._walk(root, self._main, "", None))
        self._classes = self._default_classes()
        compiler = [p for p in self._places if p.element.tag == "compiler"]
        for place in compiler:
            for name, value in WHOLE.items():
                if place.get(name) == value:
                    raise CannotEdit(f'of {name}="{value}"')
            if float(place.get("settotalmass", "-1")) > 0.0:
                raise CannotEdit("of settotalmass")
        self._degrees = not any(place.get("angle") == "radian" for place in compiler)
        options = [p for p in self._places if p.element.tag == "option"]
        self.timestep = float(self._last(options, "timestep", str(TIMESTEP)))
        self.integrator = self._last(options, "integrator", "Euler")
        self.gravity = [float(x) for x in self._last(options, "gravity", "0 0 -9.81").split()]

    def _last(self, places: Sequence[_Place], name: str, default: str) -> str:
        return next((p.get(name) for p in reversed(places) if p.get(name)), default)

    def _walk(
        self, parent: Element, file: str, inherited: str, body: Element | None
    ) -> Iterator[_Place]:
        """Yield the elements of a model in its order, with those of included files."""
        for child in parent.children:
            if child.tag == "include":
                name = str(PurePosixPath(child.attributes.get("file", "")))
                if name not in self.texts:
                    raise CannotEdit(f"the included file {name} is missing")
                yield from self._walk(self.texts[name].root, name, inherited, body)
                continue
            yield _Place(child, file, inherited, body)
            within = child if child.tag == "body" else body
            below = child.attributes.get("childclass", inherited)
            yield from self._walk(child, file, below, within)

    def _default_classes(self) -> dict[str, dict[str, dict[str, str]]]:
        """Return the attributes of each class by class and tag; actuators have one tag."""
        found: dict[str, dict[str, dict[str, str]]] = {}

        def read(element: Element, above: Mapping[str, Mapping[str, str]], name: str) -> None:
            own = {tag: dict(values) for tag, values in above.items()}
            for child in element.children:
                if child.tag != "default":
                    tag = "actuator" if child.tag in ACTUATORS else child.tag
                    own.setdefault(tag, {}).update(child.attributes)
            found[name] = own
            for child in element.children:
                if child.tag == "default":
                    read(child, own, child.attributes.get("class", ""))

        for text in self.texts.values():
            for child in text.root.children:
                if child.tag == "default":
                    read(child, found.get("main", {}), "main")
                    found[child.attributes.get("class", "main")] = found["main"]
        return found

    def _stated(self, place: _Place, name: str, tag: str) -> str | None:
        """Return an attribute of an element, by its class if not its own; None if not stated."""
        own = place.element.attributes
        kind = own.get("class") or place.inherited or "main"
        return own.get(name, self._classes.get(kind, {}).get(tag, {}).get(name))

    def _set(self, place: _Place, tag: str, values: Mapping[str, Sequence[float] | float]) -> None:
        """Write numbers where they differ from those stated; what is not stated is zero."""
        new: dict[str, str | None] = {}
        for name, value in values.items():
            wanted = np.atleast_1d(value)
            stated = [float(x) for x in (self._stated(place, name, tag) or "0").split()]
            stated += [0.0] * (len(wanted) - len(stated))
            hidden = name == "kv" and self._stated(place, "dampratio", tag) is not None
            if (
                hidden
                or len(stated) != len(wanted)
                or not np.allclose(stated, wanted, rtol=1e-12, atol=0.0)
            ):
                new[name] = str(int(wanted[0])) if name == "nsample" else vector(wanted)
        if "kv" in new and "dampratio" in place.element.attributes:
            new["dampratio"] = None  # MuJoCo allows one of the two
        if new:
            self.texts[place.file].set_attributes(place.element, new)

    def _body(self, name: str) -> _Place:
        found = [p for p in self._places if p.element.tag == "body" and p.get("name") == name]
        if len(found) != 1 or not name:
            raise CannotEdit(f"its files have no body {name!r}; give the links' bodies names")
        return found[0]

    def write_inertials(self, body: str, own: Array, share: float) -> list[str]:
        """Write the inertial of a body, and scale those of what moves rigidly with it."""
        place = self._body(body)
        text = "".join(f' {name}="{value}"' for name, value in inertial(own).items())
        self.texts[place.file].replace_child(place.element, "inertial", f"<inertial{text}/>")
        if share == 1.0:
            return []
        for below in self._carried(place.element):
            stated = below.element.find("inertial")
            if stated is None:
                raise CannotEdit(
                    f"bodies on {body} without inertials weigh more than what was identified"
                )
            scaled: dict[str, str | None] = {
                name: " ".join(number(share * float(x)) for x in stated.attributes[name].split())
                for name in ("mass", "diaginertia", "fullinertia")
                if name in stated.attributes
            }
            self.texts[below.file].set_attributes(stated, scaled)
        return [f"{body}: the masses of bodies attached to it were scaled by {share:.3g}"]

    def _carried(self, body: Element) -> Iterator[_Place]:
        """Yield the bodies behind a body that are not links of the arm."""
        behind = [body]
        for place in self._places:
            own = place.element
            if (
                own.tag == "body"
                and any(place.body is b for b in behind)
                and place.get("name") not in self._links
            ):
                behind.append(own)
                yield place

    def write_joint(self, body: str, name: str, passive: PassiveTorques) -> _Place:
        """Write armature, damping, friction loss, and where wanted the spring of a joint."""
        element = self._body(body).element
        own = [p for p in self._places if p.element.tag == "joint" and p.body is element]
        named = [p for p in own if p.get("name") == name]
        if not own:
            raise CannotEdit(f"body {body!r} has no joint of its own")
        place = (named or own)[0]
        values = {
            key: value
            for key, value in vars(passive).items()
            if value is not None
            and not (key.startswith("sol") and self._stated(place, key, "joint"))  # the user's own
        }
        sliding = self._stated(place, "type", "joint") == "slide"
        if "springref" in values and self._degrees and not sliding:
            values["springref"] = math.degrees(values["springref"])
        self._set(place, "joint", values)
        return place

    def write_actuator(self, joint: _Place, name: str, law: ActuatorLaw | None) -> list[str]:
        """Write the gains and ranges of a joint's actuator; return a note if there is none."""
        if law is None:  # torques, which nothing limits anew
            return []
        moving = [
            p
            for p in self._places
            if p.element.tag in ACTUATORS and p.get("joint") == joint.get("name", name)
        ]
        if len(moving) != 1 or moving[0].element.tag not in ("position", "general"):
            tags = ", ".join(p.element.tag for p in moving) or "none"
            return [f"joint {name}: its actuator ({tags}) is not a position servo and was kept"]
        place = moving[0]
        gear = abs(float((self._stated(place, "gear", "actuator") or "1").split()[0]))
        stiffness, damping = law.stiffness / gear**2, law.damping / gear**2
        values: dict[str, Sequence[float] | float] = {"kp": stiffness, "kv": damping}
        if place.element.tag == "general":
            values = {"gainprm": [stiffness], "biasprm": [0.0, -stiffness, -damping]}
        if math.isfinite(law.force):
            values["forcerange"] = [-law.force / gear, law.force / gear]
        if law.delay > 0.0:
            values |= {"delay": law.delay, "nsample": math.ceil(law.delay / self.timestep) + 1}
        self._set(place, "actuator", values)
        return []
