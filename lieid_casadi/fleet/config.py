"""The fleet file: arms, their fits, recordings, known payloads and limits."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import yaml

from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import require_regular
from lieid_casadi.errors import FleetError, RobotError
from lieid_casadi.fleet.recordings import is_local
from lieid_casadi.robot import yaml_text
from lieid_casadi.robot.geometry import pose
from lieid_casadi.robot.inertia import link_parameters
from lieid_casadi.robot.yaml_file import read_inertia
from lieid_casadi.robot.yaml_text import Field


@dataclass(frozen=True)
class LocatedField(Field):
    """A value of plain data with its path and, in errors, the line of the text."""

    lines: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def top(cls, text: str, origin: str) -> LocatedField:
        """Return the data of a YAML text; ``origin`` is named in errors."""
        data = yaml_text.load(text, origin)
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


T = TypeVar("T")
ARM_KEYS = (
    "fit", "robot", "train", "effects", "torque_constants", "tool", "payload", "limits",
    "maintenance",
)  # fmt: skip


@dataclass(frozen=True)
class Dated(Generic[T]):
    """A value of the fleet file and the first night for which it is valid; None: from the first."""

    value: T
    first: date | None = None


@dataclass(frozen=True, eq=False)
class KnownPayload:
    """A body at the tool that is stated in the fleet file."""

    label: str  # of the recordings with it (column ``load``); empty for those without a label
    parameters: Array  # (10,) mass, first moments, inertia about the origin of the tool frame


@dataclass(frozen=True, eq=False)
class FleetArm:
    """One arm of the fleet; what changes with time is a list of values with their first nights."""

    serial: str
    fits: tuple[Dated[str], ...]  # paths; empty: robot, train and effects state how to make one
    robot: str | None
    train: tuple[str, ...]  # recordings to fit, paths or URLs
    effects: str | None  # None: the default effects for the recordings' torque
    recordings: tuple[str, ...]  # path patterns or URLs
    torque_constants: tuple[Dated[tuple[float, ...]], ...]  # N·m/A
    tools: tuple[Dated[Array], ...]  # (4, 4) in the last link's frame; none: that of the robot
    payloads: tuple[Dated[KnownPayload], ...]
    limits: Mapping[str, tuple[float, ...]]  # effect or parameter → largest permitted values
    maintenance: tuple[tuple[date, date], ...]  # first and last night of each

    def payloads_at(self, night: date) -> list[KnownPayload]:
        """Return the payload of each label that is known on a night."""
        labels = {entry.value.label: None for entry in self.payloads}
        own = [[e for e in self.payloads if e.value.label == label] for label in labels]
        return [payload for entries in own if (payload := valid_at(entries, night)) is not None]

    def is_maintained(self, night: date) -> bool:
        """Whether a night is one of maintenance, which is left out."""
        return any(first <= night <= last for first, last in self.maintenance)


def valid_at(entries: Sequence[Dated[T]], night: date) -> T | None:
    """Return the value that is valid on a night: the one with the latest first night."""
    begun = [entry for entry in entries if entry.first is None or entry.first <= night]
    return max(begun, key=lambda entry: entry.first or date.min).value if begun else None


@dataclass(frozen=True, eq=False)
class Fleet:
    """Content of a fleet file; ``night`` is an expression that finds the date in a path."""

    arms: tuple[FleetArm, ...]
    night: str | None

    def night_pattern(self, serial: str) -> re.Pattern[str] | None:
        """Return the expression that finds the date of an arm's recording in its path."""
        if self.night is None:
            return None
        return re.compile(self.night.replace("{serial}", re.escape(serial)))


def read_fleet(path: str | Path) -> Fleet:
    """Read a fleet file; relative paths in it refer to its folder.

    FleetError: the file is missing or has an entry that is not valid; the message names the line.
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
    arms: dict[str, FleetArm] = {}
    for entry in fields["arms"].items():
        arm = _arm(entry, folder)
        if arm.serial in arms:
            field = replace(entry, value=arm.serial, path=f"{entry.path}.serial")
            raise field.error("serial numbers that differ", found=f"{arm.serial!r} twice")
        arms[arm.serial] = arm
    if not arms:
        raise fields["arms"].error("at least one arm")
    return Fleet(tuple(arms.values()), _night(fields["night"]) if "night" in fields else None)


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
    breaks = fields["maintenance"].items() if "maintenance" in fields else []
    if has_fit == has_robot:
        found = "both of them" if has_fit else "neither of them"
        raise entry.error("either fit, or robot and train", found=found)
    if has_robot and "train" not in fields:
        raise entry.error("robot together with train: recordings to fit", found="no key 'train'")
    if has_fit and ("train" in fields or "effects" in fields):
        raise entry.error("train and effects only together with robot", found="a fit with them")
    return FleetArm(
        serial=_serial(fields["serial"]),
        fits=_dated(fields.get("fit"), lambda field: _fit(field, folder)),
        robot=_robot(fields["robot"], folder) if has_robot else None,
        train=_locations(fields["train"], folder) if "train" in fields else (),
        effects=fields["effects"].text() if "effects" in fields else None,
        recordings=_locations(fields["recordings"], folder),
        torque_constants=_dated(fields.get("torque_constants"), _constants),
        tools=_dated(fields.get("tool"), _tool),
        payloads=_payloads(fields.get("payload")),
        limits=_limits(fields["limits"]) if "limits" in fields else {},
        maintenance=tuple(_span(entry) for entry in breaks),
    )


def _dated(field: LocatedField | None, read: Callable[[LocatedField], T]) -> tuple[Dated[T], ...]:
    """Return one value, or the values of a list of mappings that may have the key ``from``."""
    if field is None:
        return ()
    several = isinstance(field.value, list) and all(isinstance(x, dict) for x in field.value)
    fields = field.items() if several else [field]
    entries = tuple(Dated(read(each), _first(each)) for each in fields)
    if not entries or len({entry.first for entry in entries}) < len(entries):
        raise field.error("entries with different dates 'from'")
    return entries


def _first(entry: LocatedField) -> date | None:
    """Return the date under the key ``from`` of a mapping."""
    if not isinstance(entry.value, dict) or "from" not in entry.value:
        return None
    return _day(entry.mapping([], list(entry.value))["from"])


def _day(field: LocatedField) -> date:
    try:
        return date.fromisoformat(str(field.value))
    except ValueError:
        raise field.error("a date such as 2026-11-20") from None


def _span(entry: LocatedField) -> tuple[date, date]:
    fields = entry.mapping(["from", "to"], [])
    first, last = _day(fields["from"]), _day(fields["to"])
    if last < first:
        raise entry.error("a last night that is not before the first")
    return first, last


def _fit(field: LocatedField, folder: Path) -> str:
    if isinstance(field.value, dict):
        field = field.mapping(["path"], ["from"])["path"]
    return _location(field, folder)


def _serial(field: LocatedField) -> str:
    if isinstance(field.value, int) and not isinstance(field.value, bool):
        raise field.error("the serial number in quotation marks")
    if not field.text().strip():
        raise field.error("a serial number")
    return field.text().strip()


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
    return str(folder / text) if is_local(text) else text


def _robot(field: LocatedField, folder: Path) -> str:
    from lieid_casadi.robot.description import BUNDLED

    return field.text() if field.text() in BUNDLED else _location(field, folder)


def _constants(field: LocatedField) -> tuple[float, ...]:
    if isinstance(field.value, dict):
        field = field.mapping(["values"], ["from"])["values"]
    values = tuple(entry.number() for entry in field.items())
    if not values or 0.0 in values:
        raise field.error("numbers other than 0, N·m/A, one per joint")
    return values


def _tool(field: LocatedField) -> Array:
    fields = field.mapping(["xyz"], ["rpy", "from"])
    turned = fields["rpy"].numbers(3) if "rpy" in fields else np.zeros(3)
    return pose(fields["xyz"].numbers(3), turned)


def _payloads(field: LocatedField | None) -> tuple[Dated[KnownPayload], ...]:
    if field is None:
        return ()
    entries = field.items() if isinstance(field.value, list) else [field]
    payloads = tuple(Dated(_payload(entry), _first(entry)) for entry in entries)
    if len({(p.value.label, p.first) for p in payloads}) < len(payloads):
        raise field.error("payloads with different labels, or dates 'from'")
    return payloads


def _payload(entry: LocatedField) -> KnownPayload:
    fields = entry.mapping(["mass", "com"], ["inertia", "label", "from"])
    mass = fields["mass"].number()
    if not mass >= 0.0:
        raise fields["mass"].error("a number ≥ 0 (0: the payload is taken off)")
    inertia = read_inertia(fields["inertia"]) if "inertia" in fields else np.zeros((3, 3))
    label = fields["label"].text() if "label" in fields else ""
    return KnownPayload(label, link_parameters(mass, fields["com"].numbers(3), inertia))


def _limits(field: LocatedField) -> dict[str, tuple[float, ...]]:
    if not isinstance(field.value, dict):
        raise field.error("a mapping from effects to largest values")
    found: dict[str, tuple[float, ...]] = {}
    for name, entry in field.mapping([], list(field.value)).items():
        values = entry.items() if isinstance(entry.value, list) else [entry]
        found[name] = tuple(value.positive() for value in values)
        if not found[name]:
            raise entry.error("a number > 0, or one per joint")
    return found
