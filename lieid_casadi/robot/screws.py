"""A serial arm from arrays of screws and home poses, with numbers or CasADi symbols."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lieid_casadi.errors import RobotError
from lieid_casadi.robot.description import STANDARD_GRAVITY, Joint, Limits, RobotDescription
from lieid_casadi.robot.geometry import Geometry, expressions, geometry, pose

TOLERANCE = 1e-6  # of unit vectors and rotations: seven printed digits


def arm_of_screws(
    screws: Sequence[Any],
    homes: Sequence[Any],
    *,
    links: Sequence[Any] | None,
    tool: Any,
    gravity: Any,
    limits: Sequence[Limits] | None,
    joint_names: Sequence[str] | None,
    name: str,
) -> RobotDescription:
    """Return the arm; arguments and errors are those of `Robot.from_screws`."""
    n = len(screws)
    names = [f"joint{j + 1}" for j in range(n)] if joint_names is None else list(joint_names)
    for what, given in (("homes", homes), ("links", links), ("limits", limits), ("names", names)):
        if given is not None and len(given) != n:
            raise RobotError(
                f"robot {name!r}: {n} screws and {len(given)} {what}; expected as many"
            )
    if not n or len(set(names)) < n:
        raise RobotError(f"robot {name!r}: joints {names}; expected at least one, unique names")
    joints = tuple(
        Joint(
            names[j],
            screws[j],
            _matrix(homes[j]),
            limits=Limits() if limits is None else limits[j],
            link=None
            if links is None
            else np.asarray(geometry(links[j], (10,), f"joint {names[j]!r}: link"), dtype=float),
        )
        for j in range(n)
    )
    arm = RobotDescription(
        name,
        joints,
        gravity=np.array(STANDARD_GRAVITY) if gravity is None else gravity,
        tool=np.eye(4) if tool is None else _matrix(tool),
    )
    _check(arm)
    return arm


def _matrix(given: Any) -> Any:
    """Return a pose as a matrix, of a matrix or of ``xyz`` and ``rpy``."""
    if not isinstance(given, Mapping):
        return given
    unknown = set(given) - {"xyz", "rpy"}
    if unknown:
        raise RobotError(f"pose: unknown key {sorted(unknown)[0]!r}; expected xyz, rpy")
    zero = (0.0, 0.0, 0.0)
    return pose(given.get("xyz", zero), given.get("rpy", zero))


def _arrays(arm: RobotDescription) -> Iterator[Geometry]:
    for joint in arm.joints:
        yield joint.screw
        yield joint.home
    yield arm.tool
    yield arm.gravity


def symbols_of(arm: RobotDescription) -> tuple[Any, ...]:
    """Return the scalar SX symbols of an arm's geometry."""
    found = [x for array in _arrays(arm) for x in expressions(array)]
    if not found:
        return ()
    import casadi as ca

    return tuple(ca.symvar(ca.vertcat(*found)))


def at_values(arm: RobotDescription, values: Mapping[str, float]) -> RobotDescription:
    """Return an arm with numbers in place of its symbols."""
    symbols = symbols_of(arm)
    names = [str(symbol) for symbol in symbols]
    wrong = sorted(set(names) ^ set(values))
    if wrong:
        listed = ", ".join(names) or "none"
        raise RobotError(
            f"robot {arm.name!r}: {wrong[0]!r} has "
            f"{'no value' if wrong[0] in names else 'a value and is no symbol'}; "
            f"its symbols are {listed}"
        )
    given = [float(values[name]) for name in names]

    def number(array: Geometry) -> Geometry:
        if not expressions(array):
            return array.astype(float)
        import casadi as ca

        entries = ca.vertcat(*(ca.SX(x) for x in array.flat))
        at = ca.Function("at", list(symbols), [ca.densify(entries)])
        return np.asarray(at(*given)).reshape(array.shape)

    joints = tuple(replace(j, screw=number(j.screw), home=number(j.home)) for j in arm.joints)
    return RobotDescription(arm.name, joints, number(arm.gravity), number(arm.tool), arm.source)


def _check(arm: RobotDescription) -> None:
    """Refuse screws and poses that are none, at random values of the symbols."""
    names = [str(symbol) for symbol in symbols_of(arm)]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise RobotError(f"robot {arm.name!r}: two symbols are named {sorted(twice)[0]!r}")
    values = np.random.default_rng(0).uniform(0.2, 0.9, len(names))
    there = at_values(arm, dict(zip(names, values, strict=True)))
    for joint in there.joints:
        omega, v = joint.screw[:3], joint.screw[3:]
        size = np.linalg.norm(omega if joint.revolute else v)
        if abs(size - 1.0) > TOLERANCE or abs(omega @ v) > TOLERANCE:
            raise RobotError(
                f"joint {joint.name!r}: screw of |ω| = {np.linalg.norm(omega):.4g}, "
                f"|v| = {np.linalg.norm(v):.4g}, ω·v = {omega @ v:.4g}; expected |ω| = 1 with "
                "ω·v = 0 (revolute), or ω = 0 with |v| = 1 (prismatic)"
            )
    poses = [(f"joint {j.name!r}: home", j.home) for j in there.joints] + [("tool", there.tool)]
    for what, matrix in poses:
        rotation = matrix[:3, :3]
        rigid = np.abs(rotation @ rotation.T - np.eye(3)).max() <= TOLERANCE
        if not rigid or np.linalg.det(rotation) < 0 or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 0:
            raise RobotError(f"{what}: found no rotation and translation (4, 4)")
