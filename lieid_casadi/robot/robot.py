"""A serial arm: joints as screws, home poses, limits, link inertias."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import RobotError
from lieid_casadi.robot import bundled
from lieid_casadi.robot.joint import RobotDescription
from lieid_casadi.robot.text_file import read_text
from lieid_casadi.robot.urdf import read_urdf
from lieid_casadi.robot.yaml_file import read_yaml

logger = logging.getLogger("lieid_casadi")


@dataclass(frozen=True, eq=False)
class Robot(RobotDescription):
    """A serial chain of revolute and prismatic joints.

    Attributes
    ----------
    joints : tuple of Joint
        From the base to the tool.
    gravity : (3,)
        Gravitational acceleration in the base frame, m/s².
    tool : (4, 4)
        Pose of the tool in the last link's frame.
    source : RobotSource or None
        The text of the file that describes it.
    warnings : tuple of LieidWarning
        Doubtful statements of that file.
    """

    @classmethod
    def load(cls, path: str | Path, *, tip: str | None = None, lock: Sequence[str] = ()) -> Robot:
        """Read a robot from a URDF or YAML file, or return a bundled one by its name.

        Parameters
        ----------
        path : str or Path
            File, or ``panda``, ``panda_luo2024``, ``two_link``.
        tip : str, optional
            Last link of a URDF's chain.
        lock : sequence of str
            Joints of a URDF to lock at zero.

        Raises
        ------
        RobotError
            If the file is missing, of another type, or not a serial arm.
        """
        if str(path) in bundled.NAMES:
            if tip is not None or lock:
                raise RobotError(f"{path}: --tip and --lock apply to URDF files only")
            return cls.parse_yaml(bundled.text(str(path)), origin=str(path))
        suffix = Path(path).suffix.lower()
        if suffix in (".urdf", ".xml"):
            return cls.from_urdf(path, tip=tip, lock=lock)
        if suffix in (".yaml", ".yml"):
            if tip is not None or lock:
                raise RobotError(f"{path}: --tip and --lock apply to URDF files only")
            return cls.from_yaml(path)
        names = ", ".join(bundled.NAMES)
        raise RobotError(f"{path}: expected a .urdf or .yaml file, or one of {names}")

    @classmethod
    def from_urdf(
        cls, path: str | Path, *, tip: str | None = None, lock: Sequence[str] = ()
    ) -> Robot:
        """Read a URDF file; see :func:`lieid_casadi.robot.urdf.read_urdf`.

        Parameters
        ----------
        path : str or Path
        tip : str, optional
            Last link of the chain.
        lock : sequence of str
            Joints to lock at zero.
        """
        return cls.parse_urdf(read_text(path), tip=tip, lock=lock, origin=str(path))

    @classmethod
    def from_yaml(cls, path: str | Path) -> Robot:
        """Read a YAML file; see :mod:`lieid_casadi.robot.yaml_file`."""
        return cls.parse_yaml(read_text(path), origin=str(path))

    @classmethod
    def parse_urdf(
        cls,
        text: str,
        *,
        tip: str | None = None,
        lock: Sequence[str] = (),
        origin: str = "URDF",
    ) -> Robot:
        """Return the robot of a URDF text; see :func:`lieid_casadi.robot.urdf.read_urdf`.

        Parameters
        ----------
        text : str
        tip : str, optional
            Last link of the chain.
        lock : sequence of str
            Joints to lock at zero.
        origin : str
            Named in errors, such as the file's path.
        """
        return cls._of(read_urdf(text, tip=tip, lock=lock, origin=origin))

    @classmethod
    def parse_yaml(cls, text: str, *, origin: str = "YAML") -> Robot:
        """Return the robot of a YAML text; ``origin`` is named in errors."""
        return cls._of(read_yaml(text, origin=origin))

    @classmethod
    def _of(cls, d: RobotDescription) -> Robot:
        for warning in d.warnings:
            logger.warning("%s", warning)
        return cls(d.name, d.joints, d.gravity, d.tool, d.source, d.warnings)

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
