"""YAML text to plain data: mappings, lists, texts and numbers, within limits of size and depth.

The text is read as a stream of events, of which only plain data is made: tags and aliases are
refused. The length of the text bounds time and memory.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import yaml

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RobotError

LONGEST = 1_000_000  # characters
DEEPEST = 20

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?\.inf|\.nan", re.IGNORECASE)
_WORDS: dict[str, bool | None] = {"": None, "~": None, "null": None, "true": True, "false": False}
_LOADER: Any = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader


def load(text: str, origin: str) -> Any:
    """Return the plain data of a YAML text: dict, list, str, float, int, bool and None.

    Numbers are those of the YAML 1.2 core schema in decimal notation; everything else that is not
    quoted is text, or null, true, false. What is refused is named with line and column.
    """
    if len(text) > LONGEST:
        raise RobotError(f"{origin}: {len(text)} characters; expected at most {LONGEST}")
    try:
        return _Composer(yaml.parse(text, Loader=_LOADER)).document()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise RobotError(f"{origin}: {where}not YAML: {error.problem or error.context}") from None
    except _Refused as error:
        mark = error.event.start_mark
        raise RobotError(
            f"{origin}: line {mark.line + 1}, column {mark.column + 1}: {error}"
        ) from None
    except (yaml.YAMLError, ValueError) as error:
        raise RobotError(f"{origin}: not YAML: {' '.join(str(error).split())[:200]}") from None


class _Refused(Exception):
    """An event that has no place in plain data."""

    def __init__(self, event: Any, message: str) -> None:
        super().__init__(message)
        self.event = event


class _Composer:
    """Makes data of events, one value after another."""

    def __init__(self, events: Iterator[Any]) -> None:
        self._events = events

    def document(self) -> Any:
        """Return the data of the only document, None if there is none."""
        data, documents = None, 0
        for event in self._events:
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise _Refused(event, "found a second document, expected one")
                data = self._value(next(self._events), 0)
        return data

    def _value(self, event: Any, depth: int) -> Any:
        if depth > DEEPEST:
            raise _Refused(event, f"nested deeper than {DEEPEST} levels")
        if isinstance(event, yaml.AliasEvent):
            raise _Refused(event, f"found the alias {short(event.anchor)}, expected its value")
        if event.tag is not None and event.tag != "!":
            raise _Refused(event, f"found the tag {short(event.tag)}, expected plain YAML")
        if isinstance(event, yaml.ScalarEvent):
            return _scalar(event.value) if event.implicit[0] else event.value
        if isinstance(event, yaml.SequenceStartEvent):
            return [self._value(item, depth + 1) for item in self._until(yaml.SequenceEndEvent)]
        mapping: dict[str, Any] = {}
        for key in self._until(yaml.MappingEndEvent):
            if not isinstance(key, yaml.ScalarEvent):
                raise _Refused(key, "found a list, mapping or alias as key, expected text")
            if key.value in mapping:
                raise _Refused(key, f"key {short(key.value)} is given twice")
            mapping[key.value] = self._value(next(self._events), depth + 1)
        return mapping

    def _until(self, end: type) -> Iterator[Any]:
        for event in self._events:
            if isinstance(event, end):
                return
            yield event


def _scalar(text: str) -> str | float | int | bool | None:
    """Return the value of a plain (unquoted) scalar."""
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    if not _NUMBER.fullmatch(text):
        return text
    number = float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    whole = text.lstrip("+-").isdecimal() and abs(number) < 2**53
    return int(number) if whole else number


def short(value: Any) -> str:
    """Return a value as an error line shows it."""
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list) and len(value) > 20:
        return f"a list of {len(value)}"
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


LARGEST = 1e12  # of any number, SI: products of a few of them stay far below overflow
FARTHEST = 1e6  # m, rad


@dataclass(frozen=True)
class Field:
    """A value of plain data and its place: ``joints[2].screw`` (lists count from 0)."""

    value: Any
    path: str
    origin: str

    @classmethod
    def top(cls, text: str, origin: str) -> Field:
        """Return the data of a YAML text; ``origin`` is named in errors."""
        return cls(load(text, origin), "", origin)

    def error(self, expected: str, *, found: str | None = None) -> RobotError:
        """Return an error of one line: the place, what was found and what was expected."""
        text = f"found {short(self.value) if found is None else found}, expected {expected}"
        joint = re.match(r"joints\[(\d+)\]", self.path)
        where = f"{self.path} (joint {int(joint[1]) + 1}): " if joint else f"{self.path}: "
        return RobotError(f"{self.origin}: {where if self.path else ''}{text}")

    def mapping(self, required: Sequence[str], optional: Sequence[str] = ()) -> dict[str, Self]:
        """Return the values of a mapping, which has all required keys and no unknown ones."""
        if not isinstance(self.value, dict):
            raise self.error("a mapping")
        keys = f"the keys {', '.join((*required, *optional))}"
        for key in self.value:
            if key not in required and key not in optional:
                raise self.error(keys, found=f"unknown key {short(key)}")
        for key in required:
            if key not in self.value:
                raise self.error(keys, found=f"no key {key!r}")
        dot = "." if self.path else ""
        return {
            key: replace(self, value=value, path=f"{self.path}{dot}{key}")
            for key, value in self.value.items()
        }

    def items(self) -> list[Self]:
        """Return the values of a list."""
        if not isinstance(self.value, list):
            raise self.error("a list")
        return [replace(self, value=x, path=f"{self.path}[{k}]") for k, x in enumerate(self.value)]

    def text(self) -> str:
        """Return a text."""
        if not isinstance(self.value, str):
            raise self.error("text")
        return self.value

    def number(self, *, largest: float = LARGEST) -> float:
        """Return a finite number of at most a given size."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            raise self.error("a number")
        if not math.isfinite(self.value):
            raise self.error("a finite number")
        if abs(self.value) > largest:
            raise self.error(f"a number between −{largest:g} and {largest:g}")
        return float(self.value)

    def positive(self) -> float:
        """Return a number above zero."""
        if self.number() <= 0.0:
            raise self.error("a number > 0")
        return float(self.value)

    def numbers(self, count: int, *, largest: float = LARGEST) -> Array:
        """Return a list of numbers (count,)."""
        items = self.items()
        if len(items) != count:
            raise self.error(f"{count} numbers", found=f"a list of {len(items)}")
        return np.array([item.number(largest=largest) for item in items])
