"""A serial arm as data: joints as screws, home poses, limits, link inertias."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import RobotError

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
NOT_STATED = float("nan")


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
        Unit twist [ω; v] in the base frame at the zero pose.
    home : (4, 4)
        Pose of the link frame in the base frame at the zero pose.
    link : (10,) or None
        Link parameters about the origin of the link frame; None if not stated.
    torque_constant : float
        N·m/A at the joint, NaN if not stated.
    """

    name: str
    screw: NDArray[np.float64]
    home: NDArray[np.float64]
    limits: Limits = Limits()
    link: NDArray[np.float64] | None = None
    link_name: str = ""
    torque_constant: float = NOT_STATED

    @property
    def revolute(self) -> bool:
        """Whether the joint turns (else it slides)."""
        return bool(np.linalg.norm(self.screw[:3]) > 0.5)

    @cached_property
    def axis(self) -> NDArray[np.float64]:
        """Unit twist (6,) in the link frame: ξ = Ad(home⁻¹)·screw."""
        rotation, origin = self.home[:3, :3], self.home[:3, 3]
        omega, v = self.screw[:3], self.screw[3:]
        return np.concatenate([rotation.T @ omega, rotation.T @ (v - np.cross(origin, omega))])


@dataclass(frozen=True)
class RobotSource:
    """The text a robot was read from, kept so that a fit stands alone and exports can edit it."""

    kind: str
    text: str
    tip: str | None = None
    lock: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial chain of revolute and prismatic joints.

    Attributes
    ----------
    gravity : (3,)
        Gravitational acceleration in the base frame, m/s².
    tool : (4, 4)
        Pose of the tool in the last link's frame.
    """

    name: str
    joints: tuple[Joint, ...]
    gravity: NDArray[np.float64] = field(default_factory=lambda: np.array(STANDARD_GRAVITY))
    tool: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    source: RobotSource | None = None

    @classmethod
    def load(cls, path: str | Path, *, tip: str | None = None, lock: Sequence[str] = ()) -> Robot:
        """Read a robot from a URDF or YAML file, or take a bundled one by its name.

        Raises
        ------
        RobotError
            If the file is missing, of another type, or not a serial arm.
        """
        from lieid_casadi.robot import bundled

        if str(path) in bundled.NAMES:
            if tip is not None or lock:
                raise RobotError(f"{path}: a bundled robot has neither tips nor joints to lock")
            return bundled.load(str(path))
        suffix = Path(path).suffix.lower()
        if suffix in (".urdf", ".xml"):
            return cls.from_urdf(path, tip=tip, lock=lock)
        if suffix in (".yaml", ".yml"):
            if tip is not None or lock:
                raise RobotError(f"{path}: --tip and --lock are for URDF files")
            return cls.from_yaml(path)
        names = ", ".join(bundled.NAMES)
        raise RobotError(f"{path}: expected a .urdf or .yaml file, or one of {names}")

    @classmethod
    def from_urdf(
        cls, path: str | Path, *, tip: str | None = None, lock: Sequence[str] = ()
    ) -> Robot:
        """Read a URDF file; see :func:`lieid_casadi.robot.urdf.parse_urdf`."""
        from lieid_casadi.robot.text import read_text
        from lieid_casadi.robot.urdf import parse_urdf

        return parse_urdf(read_text(path), tip=tip, lock=lock, origin=str(path))

    @classmethod
    def from_yaml(cls, path: str | Path) -> Robot:
        """Read a YAML file; see :mod:`lieid_casadi.robot.yaml_file`."""
        from lieid_casadi.robot.text import read_text
        from lieid_casadi.robot.yaml_file import parse_yaml

        return parse_yaml(read_text(path), origin=str(path))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def links_without_inertia(self) -> tuple[str, ...]:
        """Names of the links whose inertia is not stated."""
        return tuple(j.link_name or j.name for j in self.joints if j.link is None)

    @property
    def has_inertia(self) -> bool:
        """Whether every link states its inertia."""
        return not self.links_without_inertia

    @cached_property
    def link_parameters(self) -> NDArray[np.float64]:
        """The nominal link parameters (10 n,).

        Raises
        ------
        RobotError
            Naming the links that state no inertia.
        """
        missing = self.links_without_inertia
        if missing:
            raise RobotError(
                f"robot {self.name!r}: no inertia stated for {', '.join(missing)}; "
                "add mass, centre of mass and inertia to its description"
            )
        return np.concatenate([j.link for j in self.joints if j.link is not None])

    def limit(self, name: str) -> NDArray[np.float64]:
        """Return one limit of all joints (n,), NaN where not stated; names as in `Limits`."""
        return np.array([getattr(j.limits, name) for j in self.joints], dtype=float)

    @property
    def torque_constants(self) -> NDArray[np.float64]:
        """N·m/A per joint (n,), NaN where not stated."""
        return np.array([j.torque_constant for j in self.joints], dtype=float)
