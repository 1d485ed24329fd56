"""The fleet file: arms, their fits, recordings, known payloads and limits."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import msgspec
import numpy as np
import yaml
from msgspec import Meta, Struct

from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import read_limited
from lieid_casadi.errors import FleetError, RobotError
from lieid_casadi.fleet.recordings import is_local
from lieid_casadi.robot import yaml_text
from lieid_casadi.robot.description import BUNDLED
from lieid_casadi.robot.inertia import link_parameters, pose
from lieid_casadi.robot.yaml_file import read_inertia

T = TypeVar("T")
LARGEST = 16 << 20  # bytes


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


Number = Annotated[float, Meta(ge=-1e12, le=1e12)]
Vector = tuple[Number, Number, Number]
Text = Annotated[str, Meta(min_length=1)]


class _Entry(Struct, forbid_unknown_fields=True, kw_only=True):
    """An entry that may have a first night."""

    first: date | None = msgspec.field(name="from", default=None)


class _Fit(_Entry, kw_only=True):
    path: Text


class _Constants(_Entry, kw_only=True):
    values: Annotated[list[Number], Meta(min_length=1)]


class _Tool(_Entry, kw_only=True):
    xyz: Vector
    rpy: Vector = (0.0, 0.0, 0.0)


class _Payload(_Entry, kw_only=True):
    mass: Annotated[float, Meta(ge=0.0, le=1e12)]  # 0: the payload is taken off
    com: Vector
    inertia: Any = None
    label: str = ""


class _Span(Struct, forbid_unknown_fields=True):
    first: date = msgspec.field(name="from")
    last: date = msgspec.field(name="to")


Size = Annotated[float, Meta(gt=0.0, le=1e12)]


class _Arm(Struct, forbid_unknown_fields=True, kw_only=True):
    serial: Text
    recordings: Text | Annotated[list[Text], Meta(min_length=1)]
    fit: Text | _Fit | list[Text | _Fit] = []
    robot: Text | None = None
    train: Text | list[Text] = []
    effects: str | None = None
    torque_constants: _Constants | list[Number | _Constants] = []
    tool: _Tool | list[_Tool] = []
    payload: _Payload | list[_Payload] = []
    limits: dict[str, Size | Annotated[list[Size], Meta(min_length=1)]] = {}
    maintenance: list[_Span] = []


class _File(Struct, forbid_unknown_fields=True):
    arms: Annotated[list[_Arm], Meta(min_length=1)]
    night: str | None = None


class _Refused(Exception):
    """What is wrong at a place of the file, such as ``arms[2].payload``."""

    def __init__(self, place: str, message: str) -> None:
        super().__init__(message)
        self.place = place


def read_fleet(path: str | Path) -> Fleet:
    """Read a fleet file; relative paths in it refer to its folder."""
    file = Path(path)
    try:
        text = read_limited(file, LARGEST, FleetError, "a fleet file (YAML)").decode("utf-8")
    except UnicodeDecodeError as error:
        raise FleetError(f"{path}: cannot be read as UTF-8 text ({error})") from None
    try:
        data = yaml_text.load(text, str(path))
    except RobotError as error:
        raise FleetError(str(error)) from None
    try:
        return _fleet(msgspec.convert(data, _File), file.absolute().parent)
    except msgspec.ValidationError as error:
        message, _, place = str(error).partition(" - at `$")
        found = _Refused(place.strip("`.").replace("[...]", ""), message.replace("`", "'"))
    except _Refused as error:
        found = error
    node = yaml.compose(text, Loader=yaml.SafeLoader)  # builds no objects
    line = dict(_lines(node, "")).get(found.place, 1)
    where = f" {found.place}:" if found.place else ""
    raise FleetError(f"{path}: line {line}:{where} {found}")


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


def _fleet(content: _File, folder: Path) -> Fleet:
    serials = [arm.serial.strip() for arm in content.arms]
    for k, serial in enumerate(serials):
        if serial in serials[:k]:
            raise _Refused(
                f"arms[{k}].serial", f"found {serial!r} twice, expected serial numbers that differ"
            )
    if content.night is not None:
        try:
            groups = re.compile(content.night.replace("{serial}", "x")).groupindex
        except re.error as error:
            raise _Refused("night", f"not a regular expression ({error})") from None
        if "date" not in groups:
            raise _Refused("night", "expected a regular expression with a group (?P<date>…)")
    arms = [_arm(arm, folder, f"arms[{k}]") for k, arm in enumerate(content.arms)]
    return Fleet(tuple(arms), content.night)


def _arm(arm: _Arm, folder: Path, place: str) -> FleetArm:
    if bool(arm.fit) == bool(arm.robot) or bool(arm.robot) != bool(arm.train):
        raise _Refused(place, "expected either fit, or robot and train (recordings to fit)")
    if arm.fit and arm.effects:
        raise _Refused(place, "expected effects only together with robot")
    if any(span.last < span.first for span in arm.maintenance):
        raise _Refused(f"{place}.maintenance", "expected a last night that is not before the first")
    entries = _each(arm.torque_constants)
    constants = [entry for entry in entries if isinstance(entry, _Constants)]
    if len(constants) < len(entries):
        numbers = [x for x in entries if not isinstance(x, _Constants)]
        constants.append(_Constants(values=numbers))
    if any(0.0 in entry.values for entry in constants):
        raise _Refused(f"{place}.torque_constants", "expected numbers other than 0, N·m/A")
    fits = [x if isinstance(x, _Fit) else _Fit(path=x) for x in _each(arm.fit)]
    payloads, tools = _each(arm.payload), _each(arm.tool)
    for name, keys in (
        ("fit", [entry.first for entry in fits]),
        ("torque_constants", [entry.first for entry in constants]),
        ("tool", [entry.first for entry in tools]),
        ("payload", [(entry.label, entry.first) for entry in payloads]),
    ):
        if len(set(keys)) < len(keys):
            raise _Refused(f"{place}.{name}", "expected entries with different dates 'from'")
    bundled = arm.robot is None or arm.robot in BUNDLED
    return FleetArm(
        serial=arm.serial.strip(),
        fits=tuple(Dated(_location(entry.path, folder), entry.first) for entry in fits),
        robot=arm.robot if bundled else _location(str(arm.robot), folder),
        train=tuple(_location(x, folder) for x in _each(arm.train)),
        effects=arm.effects,
        recordings=tuple(_location(x, folder) for x in _each(arm.recordings)),
        torque_constants=tuple(Dated(tuple(entry.values), entry.first) for entry in constants),
        tools=tuple(Dated(pose(entry.xyz, entry.rpy), entry.first) for entry in tools),
        payloads=tuple(Dated(_body(entry, place), entry.first) for entry in payloads),
        limits={name: tuple(_each(values)) for name, values in arm.limits.items()},
        maintenance=tuple((span.first, span.last) for span in arm.maintenance),
    )


def _each(given: Any) -> list[Any]:
    """Return a list of values, or one value as a list."""
    return given if isinstance(given, list) else [given]


def _location(text: str, folder: Path) -> str:
    """Return a URL as it is, and a path from the folder of the fleet file."""
    return str(folder / text) if is_local(text) else text


def _body(entry: _Payload, place: str) -> KnownPayload:
    inertia = np.zeros((3, 3))
    if entry.inertia is not None:
        try:
            inertia = read_inertia(yaml_text.Field(entry.inertia, f"{place}.payload", "inertia"))
        except RobotError as error:
            raise _Refused(f"{place}.payload", str(error)) from None
    return KnownPayload(entry.label, link_parameters(entry.mass, np.array(entry.com), inertia))
