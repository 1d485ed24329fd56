"""YAML text to plain data, with errors that name the place and what was found there."""

from __future__ import annotations

import math
import re
from typing import Any

import yaml

from lieid_casadi.errors import RobotError

_WORDS = {
    "object": "a mapping",
    "array": "a list",
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "null": "nothing",
}


class _Loader(yaml.SafeLoader):
    """SafeLoader that refuses a key given twice and reads 1e-3 as the number that it is."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                continue  # refused by SafeLoader
            key = key_node.value
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key!r} is given twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


# YAML 1.1, which PyYAML follows, reads a number without a point before its exponent as text.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+0123456789."),
)


def load(text: str, origin: str) -> Any:
    """Return the plain data of a YAML text: mappings, lists, texts, finite numbers.

    Raises
    ------
    RobotError
        Not YAML, a key given twice, or a number that is not finite; one line with the place.
    """
    try:
        data = yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise RobotError(f"{origin}: {where}not YAML: {error.problem or error.context}") from None
    except yaml.YAMLError as error:
        raise RobotError(f"{origin}: not YAML: {' '.join(str(error).split())}") from None
    _refuse_not_finite(data, "", origin)
    return data


def _refuse_not_finite(data: Any, path: str, origin: str) -> None:
    if isinstance(data, dict):
        for key, value in data.items():
            _refuse_not_finite(value, f"{path}.{key}" if path else str(key), origin)
    elif isinstance(data, list):
        for index, value in enumerate(data):
            _refuse_not_finite(value, f"{path}[{index}]", origin)
    elif isinstance(data, float) and not math.isfinite(data):
        raise RobotError(f"{origin}: {place(path)}: found {data}, expected a finite number")


def place(path: str) -> str:
    """Return a path in the data (lists from 0) with the joint's number (from 1) beside it."""
    match = re.match(r"joints\[(\d+)\]", path)
    return f"{path} (joint {int(match[1]) + 1})" if match else path


def explained(message: str, data: Any, keys: dict[str, tuple[str, ...]]) -> str:
    """Return a validation message of msgspec as place, what was found, what was expected.

    Parameters
    ----------
    keys : dict
        The keys that a mapping may have, by the key under which it stands ("" at the top).
    """
    what, _, path = message.partition(" - at `$")
    path = path.rstrip("`").lstrip(".")
    expected, got, _ = what.partition(", got ")
    named = re.search(r"(unknown|missing required) field `(.*)`", what)
    if named:
        verb = "unknown key" if named[1] == "unknown" else "no key"
        known = keys.get(re.sub(r"\[\d+\]$", "", path).rpartition(".")[2], ())
        text = f"found {verb} {named[2]!r}, expected the keys {', '.join(known)}"
    elif got:
        expected = re.sub(r"`([^`]*)`", lambda match: _in_words(match[1]), expected)
        text = f"found {short(_at(path, data))}, {expected[0].lower()}{expected[1:]}"
    else:
        text = what
    return f"{place(path)}: {text}" if path else text


def _in_words(kinds: str) -> str:
    return " or ".join(_WORDS.get(kind, kind) for kind in kinds.split(" | "))


def _at(path: str, data: Any) -> Any:
    for key, index in re.findall(r"([^.\[\]]+)|\[(\d+)\]", path):
        data = data[key] if key else data[int(index)]
    return data


def short(value: Any) -> str:
    """Return a value as an error line shows it."""
    if isinstance(value, dict):
        return "a mapping"
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
