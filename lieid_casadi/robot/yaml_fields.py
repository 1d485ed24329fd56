"""Values of a description with their places, read with checks that name place and value."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import RobotError
from lieid_casadi.robot.yaml_text import load, short

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

    def numbers(self, count: int, *, largest: float = LARGEST) -> NDArray[np.float64]:
        """Return a list of numbers (count,)."""
        items = self.items()
        if len(items) != count:
            raise self.error(f"{count} numbers", found=f"a list of {len(items)}")
        return np.array([item.number(largest=largest) for item in items])
