"""A serial arm: joints as screws, home poses, limits, link inertias."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RobotError
from lieid_casadi.robot.description import BUNDLED, RobotDescription, bundled_text, read_text
from lieid_casadi.robot.drive import Drive
from lieid_casadi.robot.mjcf import read_mjcf
from lieid_casadi.robot.urdf import read_urdf
from lieid_casadi.robot.yaml_file import read_yaml

logger = logging.getLogger("lieid_casadi")


@dataclass(frozen=True, eq=False, repr=False)
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
    tool_name : str
        The URDF's link whose frame is the tool; ``tool`` for other robots.
    """

    @classmethod
    def load(cls, path: str | Path, *, tip: str | None = None, lock: Sequence[str] = ()) -> Robot:
        """Read a robot from a URDF, MJCF or YAML file, or return a bundled one by its name.

        Parameters
        ----------
        path : str or Path
            File, or ``panda``, ``panda_luo2024``, ``so101``, ``two_link``.
        tip : str, optional
            Last link of a URDF's chain, or body at which an MJCF's chain ends.
        lock : sequence of str
            Joints to lock: of a URDF at zero, of an MJCF at the first keyframe.

        Raises
        ------
        RobotError
            If the file is missing, of another type, or not a serial arm.
        """
        return cls._of(read_description(path, tip=tip, lock=lock))

    @classmethod
    def from_urdf(
        cls, path: str | Path, *, tip: str | None = None, lock: Sequence[str] = ()
    ) -> Robot:
        """See `load`; the file is a URDF, whatever its name."""
        return cls.parse_urdf(read_text(path), tip=tip, lock=lock, origin=str(path))

    @classmethod
    def from_yaml(cls, path: str | Path) -> Robot:
        """See `load`; the file is YAML, whatever its name."""
        return cls.parse_yaml(read_text(path), origin=str(path))

    @classmethod
    def parse_urdf(
        cls, text: str, *, tip: str | None = None, lock: Sequence[str] = (), origin: str = "URDF"
    ) -> Robot:
        """See `from_urdf`; ``text`` is that of the file, ``origin`` is named in errors."""
        return cls._of(read_urdf(text, tip=tip, lock=lock, origin=origin))

    @classmethod
    def parse_yaml(cls, text: str, *, origin: str = "YAML") -> Robot:
        """Return the robot of a YAML text; ``origin`` is named in errors."""
        return cls._of(read_yaml(text, origin=origin))

    @classmethod
    def _of(cls, d: RobotDescription) -> Robot:
        for warning in d.warnings:
            logger.warning("%s", warning)
        return cls(d.name, d.joints, d.gravity, d.tool, d.source, d.warnings, d.tool_name)

    def __repr__(self) -> str:
        return f"<Robot {self.name}: {self.n} joints>"

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
    def link_parameters(self) -> Array:
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

    def limit(self, name: str) -> Array:
        """Return one limit of all joints (n,), NaN where not stated; names as in `Limits`."""
        return np.array([getattr(j.limits, name) for j in self.joints], dtype=float)

    @property
    def torque_constants(self) -> Array:
        """N·m/A per joint (n,), NaN where not stated."""
        return np.array([j.torque_constant for j in self.joints], dtype=float)

    @property
    def drives(self) -> tuple[Drive, ...] | None:
        """Control laws of the joints (n), within their torque limits; None if one lacks it."""
        laws = [j.drive.limited(j.limits.torque) for j in self.joints if j.drive is not None]
        return tuple(laws) if len(laws) == self.n else None

    def with_drives(self, drives: Drive | Sequence[Drive]) -> Robot:
        """Return the robot with the control laws of position-controlled drives.

        Parameters
        ----------
        drives : Drive or sequence of Drive, length n
            One law for all joints, or one per joint.

        Raises
        ------
        RobotError
            Not one law per joint.
        """
        laws = [drives] * self.n if isinstance(drives, Drive) else list(drives)
        if len(laws) != self.n:
            raise RobotError(
                f"robot {self.name!r}: {len(laws)} drive laws; expected {self.n}, one per joint"
            )
        joints = zip(self.joints, laws, strict=True)
        return replace(self, joints=tuple(replace(j, drive=law) for j, law in joints))

    def with_velocity_limits(self, velocity: ArrayLike) -> Robot:
        """Return the robot with velocity limits, rad/s or m/s: one for all joints, or (n,).

        A `RobotError` states other numbers.
        """
        values = np.atleast_1d(np.asarray(velocity, dtype=float))
        if values.shape not in ((1,), (self.n,)) or not np.all(values > 0.0):
            numbers = ", ".join(f"{value:g}" for value in values.flat)
            raise RobotError(
                f"robot {self.name!r}: velocity limits {numbers}; expected 1 or {self.n} positive "
                "numbers"
            )
        joints = zip(self.joints, np.broadcast_to(values, self.n).tolist(), strict=True)
        own = (replace(j, limits=replace(j.limits, velocity=value)) for j, value in joints)
        return replace(self, joints=tuple(own))


def read_description(
    path: str | Path, *, tip: str | None = None, lock: Sequence[str] = ()
) -> RobotDescription:
    """Read a URDF, MJCF or YAML file, or a bundled description; see `Robot.load`."""
    origin, suffix = str(path), Path(path).suffix.lower()
    if origin in BUNDLED or suffix in (".yaml", ".yml"):
        if tip is not None or lock:
            raise RobotError(f"{path}: --tip and --lock apply to URDF and MJCF only")
        text = bundled_text(origin) if origin in BUNDLED else read_text(path)
        return read_yaml(text, origin=origin)
    if suffix == ".xml" and "<mujoco" in read_text(path):
        return read_mjcf(path, tip=tip, lock=lock)
    if suffix in (".urdf", ".xml"):
        return read_urdf(read_text(path), tip=tip, lock=lock, origin=origin)
    names = ", ".join(BUNDLED)
    raise RobotError(
        f"{path}: expected a .urdf, .xml (URDF or MJCF) or .yaml file, or one of {names}"
    )
