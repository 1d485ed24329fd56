"""The fleet file: arms, their fits, recordings, known payloads and limits."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import require_regular
from lieid_casadi.errors import FleetError, RobotError
from lieid_casadi.robot import yaml_text
from lieid_casadi.robot.geometry import pose
from lieid_casadi.robot.inertia import link_parameters
from lieid_casadi.robot.yaml_text import Field


@dataclass(frozen=True)
class LocatedField(Field):
    """A value of plain data with its path and, in errors, the line of the text."""

    lines: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def top(cls, text: str, origin: str) -> LocatedField:
        """Return the data of a YAML text; ``origin`` is named in errors.

        Raises
        ------
        FleetError
            The text is not plain YAML.
        """
        try:
            data = yaml_text.load(text, origin)
        except RobotError as error:
            raise FleetError(str(error)) from None
        node = yaml.compose(text, Loader=yaml.SafeLoader)  # builds no objects
        return cls(data, "", origin, dict(_lines(node, "")))

    def error(self, expected: str, *, found: str | None = None) -> RobotError:
        """Return an error of one line: file, line, place, what was found and what was expected."""
        text = f"found {yaml_text.short(self.value) if found is None else found}"
        place = f" {self.path}:" if self.path else ""
        line = self.lines.get(self.path, 1)
        return RobotError(f"{self.origin}: line {line}:{place} {text}, expected {expected}")


def _lines(node: Any, path: str) -> Iterator[tuple[str, int]]:
    """Yield path and line, from 1, of a node and of all below it."""
    if node is None:
        return
    yield path, node.start_mark.line + 1
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            yield from _lines(value, f"{path}{'.' if path else ''}{key.value}")
    elif isinstance(node, yaml.SequenceNode):
        for k, value in enumerate(node.value):
            yield from _lines(value, f"{path}[{k}]")


ARM_KEYS = (
    "fit", "robot", "train", "effects", "torque_constants", "tool", "payload", "limits",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class KnownPayload:
    """A body at the tool that is stated in the fleet file.

    Attributes
    ----------
    label : str
        Of the recordings with this payload (column ``load``); empty for those without a label.
    parameters : (10,)
        Mass, first moments and inertia about the origin of the tool frame, kg, kg·m, kg·m².
    """

    label: str
    parameters: Array


@dataclass(frozen=True, eq=False)
class FleetArm:
    """One arm of the fleet.

    Attributes
    ----------
    serial : str
    fit : str or None
        Path of a fit; otherwise ``robot``, ``train`` and ``effects`` state how to make one.
    robot : str or None
    train : tuple of str
        Recordings to fit, paths or URLs.
    effects : str or None
        Of the model that is fitted; None: the default effects for the recordings' torque.
    recordings : tuple of str
        Path patterns or URLs.
    torque_constants : tuple of float or None
        N·m/A.
    tool : (4, 4) or None
        Pose of the tool frame in the last link's frame; None takes that of the fit's robot.
    payloads : tuple of KnownPayload
    limits : mapping
        Effect or parameter → largest permitted value of each joint, or of all of them.
    """

    serial: str
    fit: str | None
    robot: str | None
    train: tuple[str, ...]
    effects: str | None
    recordings: tuple[str, ...]
    torque_constants: tuple[float, ...] | None
    tool: Array | None
    payloads: tuple[KnownPayload, ...]
    limits: Mapping[str, tuple[float, ...]]


@dataclass(frozen=True, eq=False)
class Fleet:
    """Content of a fleet file.

    Attributes
    ----------
    arms : tuple of FleetArm
    night : str or None
        Regular expression with a group ``date``; ``{serial}`` stands for the arm's serial number.
    """

    arms: tuple[FleetArm, ...]
    night: str | None

    def night_pattern(self, serial: str) -> re.Pattern[str] | None:
        """Return the expression that finds the date of an arm's recording in its path."""
        if self.night is None:
            return None
        return re.compile(self.night.replace("{serial}", re.escape(serial)))


def read_fleet(path: str | Path) -> Fleet:
    """Read a fleet file; relative paths in it refer to its folder.

    Raises
    ------
    FleetError
        The file is missing or has an entry that is not valid; the message names the line.
    """
    file = Path(path)
    try:
        require_regular(file)
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FleetError(f"{path}: no such file; expected a fleet file (YAML)") from None
    except (OSError, UnicodeDecodeError) as error:
        raise FleetError(f"{path}: cannot be read as UTF-8 text ({error})") from None
    try:
        return _fleet(LocatedField.top(text, str(path)), file.absolute().parent)
    except RobotError as error:
        raise FleetError(str(error)) from None


def _fleet(top: LocatedField, folder: Path) -> Fleet:
    fields = top.mapping(["arms"], ["night"])
    arms = tuple(_arm(entry, folder) for entry in fields["arms"].items())
    if not arms:
        raise fields["arms"].error("at least one arm")
    seen: set[str] = set()
    for entry, arm in zip(fields["arms"].items(), arms, strict=True):
        if arm.serial in seen:
            raise entry.mapping(["serial"], ["recordings", *ARM_KEYS])["serial"].error(
                "serial numbers that differ", found=f"{arm.serial!r} twice"
            )
        seen.add(arm.serial)
    return Fleet(arms, _night(fields["night"]) if "night" in fields else None)


def _night(field: LocatedField) -> str:
    text = field.text()
    try:
        groups = re.compile(text.replace("{serial}", "x")).groupindex
    except re.error as error:
        raise field.error(f"a regular expression ({error})") from None
    if "date" not in groups:
        raise field.error("a regular expression with a group (?P<date>…)")
    return text


def _arm(entry: LocatedField, folder: Path) -> FleetArm:
    fields = entry.mapping(["serial", "recordings"], ARM_KEYS)
    has_fit, has_robot = "fit" in fields, "robot" in fields
    if has_fit == has_robot:
        found = "both of them" if has_fit else "neither of them"
        raise entry.error("either fit, or robot and train", found=found)
    if has_robot and "train" not in fields:
        raise entry.error("robot together with train: recordings to fit", found="no key 'train'")
    if has_fit and ("train" in fields or "effects" in fields):
        raise entry.error("train and effects only together with robot", found="a fit with them")
    constants = fields.get("torque_constants")
    return FleetArm(
        serial=_serial(fields["serial"]),
        fit=_location(fields["fit"], folder) if has_fit else None,
        robot=_robot(fields["robot"], folder) if has_robot else None,
        train=_locations(fields["train"], folder) if "train" in fields else (),
        effects=fields["effects"].text() if "effects" in fields else None,
        recordings=_locations(fields["recordings"], folder),
        torque_constants=None if constants is None else _constants(constants),
        tool=_tool(fields["tool"]) if "tool" in fields else None,
        payloads=_payloads(fields["payload"]) if "payload" in fields else (),
        limits=_limits(fields["limits"]) if "limits" in fields else {},
    )


def _serial(field: LocatedField) -> str:
    if isinstance(field.value, int) and not isinstance(field.value, bool):
        raise field.error("the serial number in quotation marks")
    text = field.text().strip()
    if not text:
        raise field.error("a serial number")
    return text


def _locations(field: LocatedField, folder: Path) -> tuple[str, ...]:
    entries = field.items() if isinstance(field.value, list) else [field]
    if not entries:
        raise field.error("a path pattern or URL, or a list of them")
    return tuple(_location(entry, folder) for entry in entries)


def _location(field: LocatedField, folder: Path) -> str:
    """Return a URL as it is, and a path from the folder of the fleet file."""
    text = field.text()
    if not text:
        raise field.error("a path or URL")
    return text if "://" in text or "::" in text else str(folder / text)


def _robot(field: LocatedField, folder: Path) -> str:
    from lieid_casadi.robot.description import BUNDLED

    return field.text() if field.text() in BUNDLED else _location(field, folder)


def _constants(field: LocatedField) -> tuple[float, ...]:
    values = tuple(entry.number() for entry in field.items())
    if not values or 0.0 in values:
        raise field.error("numbers other than 0, N·m/A, one per joint")
    return values


def _tool(field: LocatedField) -> Array:
    fields = field.mapping(["xyz"], ["rpy"])
    turned = fields["rpy"].numbers(3) if "rpy" in fields else np.zeros(3)
    return pose(fields["xyz"].numbers(3), turned)


def _payloads(field: LocatedField) -> tuple[KnownPayload, ...]:
    entries = field.items() if isinstance(field.value, list) else [field]
    payloads = tuple(_payload(entry) for entry in entries)
    if len({p.label for p in payloads}) < len(payloads):
        raise field.error("payloads with different labels")
    return payloads


def _payload(entry: LocatedField) -> KnownPayload:
    fields = entry.mapping(["mass", "com"], ["inertia", "label"])
    inertia = np.zeros((3, 3))
    if "inertia" in fields:
        parts = fields["inertia"].mapping(["ixx", "iyy", "izz"], ["ixy", "ixz", "iyz"])
        for name, part in parts.items():
            i, j = "xyz".index(name[1]), "xyz".index(name[2])
            inertia[i, j] = inertia[j, i] = part.number()
    label = fields["label"].text() if "label" in fields else ""
    return KnownPayload(
        label, link_parameters(fields["mass"].positive(), fields["com"].numbers(3), inertia)
    )


def _limits(field: LocatedField) -> dict[str, tuple[float, ...]]:
    found: dict[str, tuple[float, ...]] = {}
    if not isinstance(field.value, dict):
        raise field.error("a mapping from effects to largest values")
    for name, entry in field.mapping([], list(field.value)).items():
        values = entry.items() if isinstance(entry.value, list) else [entry]
        found[name] = tuple(value.positive() for value in values)
        if not found[name]:
            raise entry.error("a number > 0, or one per joint")
    return found
