"""What a file states about a robot: joints, limits and links as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import read_limited
from lieid_casadi.errors import LieidWarning, RobotError
from lieid_casadi.robot.drive import Drive

STANDARD_GRAVITY = (0.0, 0.0, -9.81)  # m/s²
NOT_STATED = float("nan")
MOST_JOINTS = 100  # of an arm


@dataclass(frozen=True)
class Limits:
    """Limits of one joint (rad or m, and their rates, N·m or N); NaN where not stated."""

    position_lower: float = NOT_STATED
    position_upper: float = NOT_STATED
    velocity: float = NOT_STATED
    acceleration: float = NOT_STATED
    torque: float = NOT_STATED


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint and the link that it moves.

    Attributes
    ----------
    screw : (6,)
        Unit twist [ω; v] in the base frame at the zero pose; ω = 0: prismatic.
    home : (4, 4)
        Pose of the link frame in the base frame at the zero pose.
    link : (10,) or None
        Link parameters about the origin of the link frame; None if not stated.
    torque_constant : float
        N·m/A at the joint, NaN if not stated.
    drive : Drive or None
        Control law of a position-controlled drive.
    """

    name: str
    screw: Array
    home: Array
    limits: Limits = Limits()
    link: Array | None = None
    link_name: str = ""
    torque_constant: float = NOT_STATED
    drive: Drive | None = None

    def __post_init__(self) -> None:
        for name, shape in (("screw", (6,)), ("home", (4, 4))):
            value = _array(getattr(self, name), shape, f"joint {self.name!r}: {name}")
            object.__setattr__(self, name, value)

    @property
    def revolute(self) -> bool:
        """Whether the joint rotates; otherwise it is prismatic."""
        return bool(np.linalg.norm(self.screw[:3]) > 0.5)

    @cached_property
    def axis(self) -> Array:
        """Unit twist (6,) in the link frame: ξ = Ad(home⁻¹)·screw."""
        rotation, origin = self.home[:3, :3], self.home[:3, 3]
        omega, v = self.screw[:3], self.screw[3:]
        return np.concatenate([rotation.T @ omega, rotation.T @ (v - np.cross(origin, omega))])


def _array(values: ArrayLike, shape: tuple[int, ...], what: str) -> Array:
    array = np.asarray(values, dtype=float)
    if array.shape != shape:
        raise RobotError(f"{what}: numbers of shape {array.shape}; expected {shape}")
    return array


@dataclass(frozen=True)
class RobotSource:
    """The text from which a robot was read: a fit embeds it, and exports edit it."""

    kind: str  # urdf, mjcf or yaml
    text: str
    tip: str | None = None  # of the chain
    lock: tuple[str, ...] = ()
    #: of a MuJoCo model: names, relative to its folder, and texts of it and of what it includes
    files: tuple[tuple[str, str], ...] = ()
    #: of a MuJoCo model, per joint: name of its body, link parameters of what moves with it
    carried: tuple[tuple[str, tuple[float, ...]], ...] = ()


@dataclass(frozen=True, eq=False)
class RobotDescription:
    """What a file states about a robot; the fields are those of `Robot`."""

    name: str
    joints: tuple[Joint, ...]
    gravity: Array = field(default_factory=lambda: np.array(STANDARD_GRAVITY))
    tool: Array = field(default_factory=lambda: np.eye(4))
    source: RobotSource | None = None
    warnings: tuple[LieidWarning, ...] = ()
    tool_name: str = "tool"

    def __post_init__(self) -> None:
        for name, shape in (("gravity", (3,)), ("tool", (4, 4))):
            value = _array(getattr(self, name), shape, f"robot {self.name!r}: {name}")
            object.__setattr__(self, name, value)


#: Names of the bundled robots.
BUNDLED = ("panda", "panda_luo2024", "so101", "two_link")
LARGEST = 16 << 20  # bytes; descriptions with every mesh's name take well below one million


def read_text(path: str | Path) -> str:
    """Return the text of a file."""
    try:
        return read_limited(path, LARGEST, RobotError, "a description").decode("utf-8")
    except UnicodeDecodeError:
        raise RobotError(f"{path}: not a text file (expected UTF-8)") from None


def bundled_text(name: str) -> str:
    """Return the YAML of a bundled robot; it names the sources of its numbers."""
    file = resources.files("lieid_casadi.robot").joinpath("data", f"{name}.yaml")
    return file.read_text("utf-8")
