"""A fit written into the user's own MuJoCo model: inertials, joints' passive torques, actuators.

Everything else stays as it is, character by character: default classes, names, geoms, sites,
cameras, sensors, keyframes, comments. Attributes are written onto the elements themselves, and only
where they differ from what the file and its default classes state.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.simulator_joints import (
    ActuatorLaw,
    LinearFriction,
    PassiveTorques,
    actuator_law,
    for_steps,
    inertial,
    number,
    passive_torques,
    vector,
)
from lieid_casadi.exporters.urdf import split
from lieid_casadi.exporters.xml_text import Element, XmlText
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot.description import RobotSource
from lieid_casadi.robot.urdf import RigidMember

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
