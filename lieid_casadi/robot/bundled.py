"""The robots that come with the package, by name."""

from __future__ import annotations

from importlib import resources

from lieid_casadi.robot.robot import Robot

NAMES = ("panda", "panda_luo2024", "two_link")


def load(name: str) -> Robot:
    """Return a bundled robot; its YAML file, with the source of its numbers, is in ``data``."""
    from lieid_casadi.robot.yaml_file import parse_yaml

    text = resources.files("lieid_casadi.robot").joinpath("data", f"{name}.yaml").read_text("utf-8")
    return parse_yaml(text, origin=name)
