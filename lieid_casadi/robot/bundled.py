"""The descriptions of the bundled robots, by name."""

from __future__ import annotations

from importlib import resources

NAMES = ("panda", "panda_luo2024", "so101", "two_link")


def text(name: str) -> str:
    """Return the YAML of a bundled robot; it names the sources of its numbers."""
    file = resources.files("lieid_casadi.robot").joinpath("data", f"{name}.yaml")
    return file.read_text("utf-8")
