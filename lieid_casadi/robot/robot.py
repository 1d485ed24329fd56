"""A serial arm: joints as screws, home poses, limits, link inertias."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import RobotError
from lieid_casadi.robot.description import (
    BUNDLED,
    Limits,
    RobotDescription,
    bundled_text,
    read_text,
)
from lieid_casadi.robot.drive import Drive
from lieid_casadi.robot.geometry import expressions
from lieid_casadi.robot.mjcf import read_mjcf
from lieid_casadi.robot.screws import arm_of_screws, at_values, symbols_of
from lieid_casadi.robot.urdf import read_urdf
from lieid_casadi.robot.yaml_file import read_yaml

logger = logging.getLogger("lieid_casadi")


@dataclass(frozen=True, eq=False, repr=False)
class Robot(RobotDescription):
    """A serial chain of revolute and prismatic joints.

    Screws, home poses, tool and gravity are numbers, or contain CasADi symbols (`from_screws`).

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
    def from_mjcf(
        cls, path: str | Path, *, tip: str | None = None, lock: Sequence[str] = ()
    ) -> Robot:
        """See `load`; the file is a MuJoCo model (extra ``mujoco``), whatever its name."""
        return cls._of(read_mjcf(path, tip=tip, lock=lock))

    @classmethod
    def from_yaml(cls, path: str | Path) -> Robot:
        """See `load`; the file is YAML, whatever its name."""
        return cls.parse_yaml(read_text(path), origin=str(path))

    @classmethod
    def from_screws(
        cls,
        screws: Sequence[Any],
        homes: Sequence[Any],
        *,
        links: Sequence[Any] | None = None,
        tool: Any = None,
        gravity: Any = None,
        limits: Sequence[Limits] | None = None,
        joint_names: Sequence[str] | None = None,
        name: str = "robot",
    ) -> Robot:
        """Return the robot of given screws, whose geometry may contain CasADi symbols.

        Screws, homes, tool and gravity take numbers or SX. `lieid_casadi.symbolic` returns
        functions with the symbols as further inputs, by their names.

        Parameters
        ----------
        screws : n of (6,)
            Unit twist [ω; v] of each joint in the base frame at the zero pose; ω = 0: prismatic.
        homes : n of (4, 4) or of {"xyz": (3,), "rpy": (3,)}
            Link frames in the base frame at the zero pose, m and rad.
        links : n of (10,), optional
            Link parameters, SI. Without them, ``lieid.symbolic(lieid.Model(robot))`` has them as
            an input.
        tool : (4, 4) or {"xyz": (3,), "rpy": (3,)}, optional
            Tool in the last link's frame; the identity if left out.
        gravity : (3,), optional
            In the base frame, m/s²; (0, 0, −9.81) if left out.
        limits : n of Limits, optional
        joint_names : n of str, optional
            Unique names; ``joint1`` … if left out.
        name : str
            Of the robot.

        Raises
        ------
        RobotError
            A shape is wrong, a screw is no unit twist of zero pitch or a home no rigid pose (tried
            at random values of the symbols), two symbols or two joints have one name.

        Examples
        --------
        >>> import casadi as ca
        >>> a = ca.SX.sym("a")
        >>> arm = Robot.from_screws(
        ...     [[0, 0, 1, 0, 0, 0], [0, 0, 1, 0, -a, 0]],
        ...     [{"xyz": [0, 0, 0]}, {"xyz": [a, 0, 0]}],
        ... )
        >>> [str(symbol) for symbol in arm.symbols]
        ['a']
        """
        return cls._of(
            arm_of_screws(
                screws, homes, links=links, tool=tool, gravity=gravity, limits=limits,
                joint_names=joint_names, name=name,
            )
        )  # fmt: skip

    @classmethod
    def parse_urdf(
        cls,
        text: str,
        *,
        tip: str | None = None,
        lock: Sequence[str] = (),
        origin: str = "URDF",
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

    @cached_property
    def has_symbols(self) -> bool:
        """Whether the geometry has entries that are not numbers."""
        arrays = [a for joint in self.joints for a in (joint.screw, joint.home)]
        return any(expressions(a) for a in (*arrays, self.tool, self.gravity))

    @cached_property
    def symbols(self) -> tuple[Any, ...]:
        """The scalar SX symbols in screws, homes, tool and gravity; empty for numbers."""
        return symbols_of(self)

    def with_values(self, values: Mapping[str, float]) -> Robot:
        """Return the robot with numbers in place of all symbols, given by their names.

        Raises
        ------
        RobotError
            A symbol has no value, or a name is none of a symbol.
        """
        return self._of(at_values(self, values))

    def require_numbers(self, what: str) -> None:
        """Raise `RobotError` if the geometry has symbols; ``what`` needs numbers."""
        if self.symbols:
            names = ", ".join(str(symbol) for symbol in self.symbols)
            raise RobotError(
                f"{what} needs numbers, and robot {self.name!r} has the symbols {names}; "
                "expected robot.with_values({name: value, …}), or lieid.symbolic(robot)"
            )

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
