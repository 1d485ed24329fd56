"""Lines of the values in a YAML text, for error messages that name them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import yaml

from lieid_casadi.errors import FleetError, RobotError
from lieid_casadi.robot import yaml_text
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
