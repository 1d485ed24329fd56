"""Types of options: numbers with a range, and paths whose use is checked before any work."""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import stat
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

from lieid_casadi.errors import UsageError


class InputPath(str):
    """A file or folder that a command reads; ``REC@T0:T1`` is a part of a recording."""

    @property
    def file(self) -> Path:
        """The file or folder itself."""
        path, at, _ = self.rpartition("@")
        return Path(path if at and not os.path.exists(self) else self)


class OutputFile(str):
    """A file that a command writes."""


class OutputFolder(str):
    """A folder that a command writes."""


class ResumedFolder(OutputFolder):
    """A folder in which a command goes on with what an earlier call began."""


def _checked(
    convert: Callable[[str], Any], holds: Callable[[Any], bool], message: str
) -> Callable[[str], Any]:
    """Return a type of options: a value that can be converted and for which a condition holds."""

    def kind(text: str) -> Any:
        with contextlib.suppress(ValueError):
            if holds(value := convert(text)):
                return value
        raise argparse.ArgumentTypeError(message.format(text))

    return kind


def number(text: str) -> float:
    """Return a finite number."""
    several = ", several are separated by spaces" if "," in text else ""
    value: float = _checked(float, math.isfinite, "{}: expected a number" + several)(text)
    return value


def height(text: str) -> float | None:
    """Return a height in m, or None for ``none``."""
    return None if text == "none" else number(text)


def known_mass(text: str) -> tuple[str, float]:
    """Return link and mass of ``LINK=KG``."""
    link, _, mass = text.rpartition("=")
    message = f"{text}: expected LINK=KG, a link and kg above 0"
    return link, _checked(float, lambda kg: bool(link) and 0.0 < kg < math.inf, message)(mass)


#: The kinds of values in the options of commands, by the names that they have there.
KINDS: dict[str, Callable[[str], Any]] = {
    "input": InputPath,
    "output": OutputFile,
    "folder": OutputFolder,
    "resumed": ResumedFolder,
    "int": int,
    "number": number,
    "count": _checked(int, lambda x: x >= 1, "{}: expected a whole number, 1 or more"),
    "above": _checked(float, lambda x: 0.0 < x < math.inf, "{}: expected a number above 0"),
    "height": height,
    "mass": known_mass,
    "seed": _checked(int, lambda x: x >= 0, "{}: expected a whole number, 0 or more"),
    "port": _checked(int, lambda x: 1 <= x < 65536, "{}: expected a port, 1 to 65535"),
    "night": _checked(date.fromisoformat, bool, "{}: expected a date such as 2026-11-20"),
    "part": _checked(
        float,
        lambda x: 0.0 <= x < 1.0,
        "expected a number from 0 to less than 1, found {!r}",
    ),
}


def check_paths(args: argparse.Namespace) -> None:
    """Refuse outputs that cannot be written or that are inputs, before any work is done."""
    from lieid_casadi.atomic_file import check_file
    from lieid_casadi.output_folder import check_folder

    values = _values(args)
    seen: set[str] = set()
    for output in (value for value in values if isinstance(value, (OutputFile, OutputFolder))):
        if isinstance(output, ResumedFolder):
            pass  # what it holds is checked when it is resumed
        elif isinstance(output, OutputFolder):
            check_folder(output, force=args.force)
        else:
            check_file(output)
        for given in (value for value in values if isinstance(value, InputPath)):
            if _overwrites(output, given.file):
                raise UsageError(f"{output}: is also an input ({given}); expected another output")
        place = os.path.realpath(output)
        if place in seen and (os.path.isfile(place) or not os.path.exists(place)):
            raise UsageError(f"{output}: is written by two options; expected different files")
        seen.add(place)


def writes_to_stdout(args: argparse.Namespace) -> bool:
    """Return whether a file that a command writes is standard output, as ``/dev/stdout``."""
    for value in _values(args):
        if isinstance(value, OutputFile):
            with contextlib.suppress(OSError):
                if os.path.samestat(os.stat(value), os.fstat(1)):
                    return True
    return False


def _values(args: argparse.Namespace) -> list[object]:
    """Return the values of all options, one by one."""
    values: list[object] = []
    for value in vars(args).values():
        values += value if isinstance(value, (list, tuple)) else (value,)
    return values


def _overwrites(output: str, given: Path) -> bool:
    """Return whether writing an output would replace an input or a file in it."""
    try:
        source, target = given.stat(), os.stat(output)
    except OSError:
        return False  # one of them does not exist
    if stat.S_ISCHR(target.st_mode) or stat.S_ISFIFO(target.st_mode):
        return False  # a terminal or a pipe may be both
    if os.path.samestat(source, target):
        return True
    inner, outer = Path(output).resolve(), given.resolve()
    if isinstance(output, OutputFolder):
        inner, outer = outer, inner
    return outer.is_dir() and inner.is_relative_to(outer)
