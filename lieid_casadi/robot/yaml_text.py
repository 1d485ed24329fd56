"""YAML text to plain data: mappings, lists, texts and numbers, within limits of size and depth.

The text is read as a stream of events, of which only plain data is made: tags are refused, and an
alias counts as many values as it repeats. The length of the text bounds time and memory.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import yaml

from lieid_casadi.errors import RobotError

LONGEST = 1_000_000  # characters
MOST_VALUES = 100_000
DEEPEST = 20

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?\.inf|\.nan", re.IGNORECASE)
_WORDS: dict[str, bool | None] = {"": None, "~": None, "null": None, "true": True, "false": False}
_LOADER: Any = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader


def load(text: str, origin: str) -> Any:
    """Return the plain data of a YAML text: dict, list, str, float, int, bool and None.

    Numbers are those of the YAML 1.2 core schema in decimal notation; everything else that is not
    quoted is text, or null, true, false.

    Parameters
    ----------
    text : str
    origin : str
        Named in errors, such as the file's path.

    Raises
    ------
    RobotError
        Not YAML, a tag, a key given twice, or more than the limits of this module allow; one line
        that names the line and column.
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
        self._anchors: dict[str, tuple[Any, int]] = {}  # complete values, and how many they hold
        self._values = 0

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
            if event.anchor not in self._anchors:
                raise _Refused(event, f"alias {short(event.anchor)} of no complete value before it")
            data, values = self._anchors[event.anchor]
            self._count(event, values)
            return data
        if event.tag is not None and event.tag != "!":
            raise _Refused(event, f"found the tag {short(event.tag)}, expected plain YAML")
        first = self._values
        self._count(event, 1)
        data = self._content(event, depth)
        if event.anchor is not None:
            self._anchors[event.anchor] = data, self._values - first
        return data

    def _content(self, event: Any, depth: int) -> Any:
        if isinstance(event, yaml.ScalarEvent):
            return _scalar(event.value) if event.implicit[0] else event.value
        if isinstance(event, yaml.SequenceStartEvent):
            items = self._until(yaml.SequenceEndEvent)
            return [self._value(item, depth + 1) for item in items]
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

    def _count(self, event: Any, values: int) -> None:
        self._values += values
        if self._values > MOST_VALUES:
            raise _Refused(event, f"more than {MOST_VALUES} values, aliases included")


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
