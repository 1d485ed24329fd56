"""A serial arm as YAML: screws in the base frame, home poses, limits, inertias.

.. code-block:: yaml

    name: lift
    gravity: [0, 0, -9.81]            # m/s², in the base frame; this is the default
    joints:
      - name: turn
        screw: [0, 0, 1, 0, 0, 0]     # [ω; v] in the base frame at the zero pose; ω = 0: prismatic
        home: {xyz: [0, 0, 0.3], rpy: [0, 0, 0]}
        limits: {position: [-3.1, 3.1], velocity: 2.0, acceleration: 8.0, torque: 80.0}
        torque_constant: 11.0         # N·m/A at the joint, for currents in place of torques
        link:
          mass: 3.0
          com: [0.1, 0, 0]            # in the link frame
          inertia: {ixx: 0.02, ixy: 0, iyy: 0.03, ixz: 0, iyz: 0, izz: 0.03}
    tool: {xyz: [0.2, 0, 0], rpy: [0, 0, 0]}

``name``, ``joints`` and each joint's ``name`` and ``screw`` must be there; the rest is optional.

- ``home`` is the link frame in the base frame at the zero pose, ``rpy`` in URDF's sense
  (Rz·Ry·Rx). Without it the link frame is the base frame at the zero pose, as is usual in the
  product of exponentials: ``tool`` is then the tool's pose in the base frame at the zero pose.
- ``com`` is in the link frame, ``inertia`` about the centre of mass in the link frame's axes: a
  mapping (products of inertia may be left out), six numbers in the order of the link parameters
  (Ixx, Ixy, Iyy, Ixz, Iyz, Izz), or a 3×3 matrix.
- Limits are in rad, rad/s, rad/s², N·m (prismatic: m, m/s, m/s², N).
"""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import yaml
from numpy.typing import NDArray

from lieid_casadi.errors import RobotError
from lieid_casadi.robot.inertia import body_inertia, link_parameters, symmetric
from lieid_casadi.robot.pose import pose, roll_pitch_yaw
from lieid_casadi.robot.robot import (
    NOT_STATED,
    STANDARD_GRAVITY,
    Joint,
    Limits,
    Robot,
    RobotSource,
)
from lieid_casadi.robot.yaml_text import explained, load, place, short

# Seven printed digits of a unit vector pass, a wrong axis does not.
SCREW_TOLERANCE = 1e-6

Three = tuple[float, float, float]


class _Pose(msgspec.Struct, forbid_unknown_fields=True):
    xyz: Three = (0.0, 0.0, 0.0)
    rpy: Three = (0.0, 0.0, 0.0)


class _Limits(msgspec.Struct, forbid_unknown_fields=True):
    position: tuple[float, float] | None = None
    velocity: float | None = None
    acceleration: float | None = None
    torque: float | None = None


class _Inertia(msgspec.Struct, forbid_unknown_fields=True):
    ixx: float
    iyy: float
    izz: float
    ixy: float = 0.0
    ixz: float = 0.0
    iyz: float = 0.0


class _Link(msgspec.Struct, forbid_unknown_fields=True):
    mass: float
    com: Three
    inertia: _Inertia | list[float | list[float]]


class _Joint(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    screw: tuple[float, float, float, float, float, float]
    home: _Pose = msgspec.field(default_factory=_Pose)
    limits: _Limits = msgspec.field(default_factory=_Limits)
    torque_constant: float | None = None
    link: _Link | None = None


class _Robot(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    joints: list[_Joint]
    gravity: Three = STANDARD_GRAVITY
    tool: _Pose = msgspec.field(default_factory=_Pose)


_STRUCTS: dict[str, type[msgspec.Struct]] = {
    "": _Robot,
    "joints": _Joint,
    "home": _Pose,
    "tool": _Pose,
    "limits": _Limits,
    "link": _Link,
    "inertia": _Inertia,
}
_KEYS = {place: struct.__struct_fields__ for place, struct in _STRUCTS.items()}


def parse_yaml(text: str, *, origin: str = "YAML") -> Robot:
    """Return the serial arm that a YAML text describes (keys: see the module).

    Parameters
    ----------
    text : str
        The YAML.
    origin : str
        Named in errors, such as the file's path.

    Raises
    ------
    RobotError
        One line that names the place, what was found and what was expected: not YAML, an unknown
        or missing key, text in place of a number, a number that is not finite, a screw that is
        not one of a revolute or prismatic joint, a position range or limit that is not one, two
        joints of one name.

    Examples
    --------
    >>> robot = parse_yaml("{name: one, joints: [{name: turn, screw: [0, 0, 1, 0, 0, 0]}]}")
    >>> robot.n, robot.joints[0].revolute
    (1, True)
    """
    data = load(text, origin)
    try:
        read = msgspec.convert(data, _Robot)
    except msgspec.ValidationError as error:
        raise RobotError(f"{origin}: {explained(str(error), data, _KEYS)}") from None
    if not read.joints:
        raise RobotError(f"{origin}: joints: found an empty list, expected at least one joint")
    names: dict[str, int] = {}
    for index, joint in enumerate(read.joints):
        if joint.name in names:
            raise RobotError(
                f"{origin}: {place(f'joints[{index}].name')}: found {joint.name!r}, the name of "
                f"joint {names[joint.name] + 1} too; expected a name of its own"
            )
        names[joint.name] = index
    return Robot(
        name=read.name,
        joints=tuple(
            _joint(joint, f"joints[{index}]", origin) for index, joint in enumerate(read.joints)
        ),
        gravity=np.array(read.gravity),
        tool=pose(read.tool.xyz, read.tool.rpy),
        source=RobotSource("yaml", text),
    )


def write_yaml(robot: Robot) -> str:
    """Return the YAML of a robot; `parse_yaml` reads it back (to round-off).

    The names of links and the text that the robot was read from are not part of it.
    """
    joints = [_joint_as_dict(joint) for joint in robot.joints]
    data = {
        "name": robot.name,
        "gravity": _numbers(robot.gravity),
        "joints": joints,
        "tool": _pose_as_dict(robot.tool),
    }
    return str(
        yaml.safe_dump(
            data, sort_keys=False, default_flow_style=None, allow_unicode=True, width=1000
        )
    )


def _joint(read: _Joint, path: str, origin: str) -> Joint:
    constant = read.torque_constant
    if constant is not None and constant == 0.0:
        raise RobotError(
            f"{origin}: {place(path + '.torque_constant')}: found 0, expected N·m/A other than 0"
        )
    return Joint(
        name=read.name,
        screw=_screw(np.array(read.screw), f"{path}.screw", origin),
        home=pose(read.home.xyz, read.home.rpy),
        limits=_limits(read.limits, f"{path}.limits", origin),
        link=None if read.link is None else _link(read.link, f"{path}.link", origin),
        torque_constant=NOT_STATED if constant is None else constant,
    )


def _screw(screw: NDArray[np.float64], path: str, origin: str) -> NDArray[np.float64]:
    """Return the unit twist, free of what rounding in the file left over."""
    omega, v = screw[:3], screw[3:]
    where = f"{origin}: {place(path)}"
    if not omega.any():
        length = float(np.linalg.norm(v))
        if abs(length - 1.0) > SCREW_TOLERANCE:
            raise RobotError(
                f"{where}: ω = 0 (a prismatic joint) and |v| = {length:.9g}, expected |v| = 1: "
                "divide v by its length, or state ω for a revolute joint"
            )
        return np.concatenate([omega, v / length])
    length = float(np.linalg.norm(omega))
    if abs(length - 1.0) > SCREW_TOLERANCE:
        raise RobotError(
            f"{where}: |ω| = {length:.9g}, expected 1 (revolute) or ω = 0 (prismatic): divide the "
            "six numbers by |ω|"
        )
    pitch = float(omega @ v)
    if abs(pitch) > SCREW_TOLERANCE * max(1.0, float(np.linalg.norm(v))):
        raise RobotError(
            f"{where}: v does not belong to ω: ω·v = {pitch:.9g}, expected 0; a revolute joint "
            "through the point p has v = −ω × p"
        )
    omega = omega / length
    return np.concatenate([omega, v - (omega @ v) * omega])


def _limits(read: _Limits, path: str, origin: str) -> Limits:
    lower, upper = NOT_STATED, NOT_STATED
    if read.position is not None:
        lower, upper = read.position
        if not lower < upper:
            raise RobotError(
                f"{origin}: {place(path + '.position')}: found [{lower:g}, {upper:g}], expected "
                "[lower, upper] with lower < upper"
            )
    stated = {}
    for name in ("velocity", "acceleration", "torque"):
        value = getattr(read, name)
        if value is not None and value <= 0.0:
            raise RobotError(
                f"{origin}: {place(f'{path}.{name}')}: found {value:g}, expected a number > 0"
            )
        stated[name] = NOT_STATED if value is None else value
    return Limits(position_lower=lower, position_upper=upper, **stated)


def _link(read: _Link, path: str, origin: str) -> NDArray[np.float64]:
    if read.mass < 0.0:
        raise RobotError(
            f"{origin}: {place(path + '.mass')}: found {read.mass:g}, expected kg, not negative"
        )
    return link_parameters(read.mass, read.com, _inertia(read.inertia, f"{path}.inertia", origin))


def _inertia(
    read: _Inertia | list[float | list[float]], path: str, origin: str
) -> NDArray[np.float64]:
    if isinstance(read, _Inertia):
        return symmetric([read.ixx, read.ixy, read.iyy, read.ixz, read.iyz, read.izz])
    rows = [len(row) if isinstance(row, list) else 0 for row in read]
    if rows == [0] * 6:
        return symmetric(read)
    if rows != [3, 3, 3]:
        raise RobotError(
            f"{origin}: {place(path)}: found {short(read)}, expected ixx, ixy, iyy, ixz, iyz, "
            "izz as a mapping or in this order, or a 3×3 matrix"
        )
    matrix: NDArray[np.float64] = np.array(read, dtype=float)
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
        raise RobotError(
            f"{origin}: {place(path)}: found a matrix that is not symmetric, expected one that is"
        )
    return np.asarray(0.5 * (matrix + matrix.T))


def _numbers(values: NDArray[np.float64]) -> list[float]:
    return [float(value) + 0.0 for value in values]  # no -0.0


def _pose_as_dict(matrix: NDArray[np.float64]) -> dict[str, list[float]]:
    return {"xyz": _numbers(matrix[:3, 3]), "rpy": _numbers(roll_pitch_yaw(matrix[:3, :3]))}


def _joint_as_dict(joint: Joint) -> dict[str, Any]:
    data: dict[str, Any] = {
        "name": joint.name,
        "screw": _numbers(joint.screw),
        "home": _pose_as_dict(joint.home),
    }
    limits = joint.limits
    stated: dict[str, Any] = {}
    if math.isfinite(limits.position_lower) and math.isfinite(limits.position_upper):
        stated["position"] = [limits.position_lower, limits.position_upper]
    for name in ("velocity", "acceleration", "torque"):
        if math.isfinite(getattr(limits, name)):
            stated[name] = getattr(limits, name)
    if stated:
        data["limits"] = stated
    if math.isfinite(joint.torque_constant):
        data["torque_constant"] = joint.torque_constant
    if joint.link is not None:
        body = body_inertia(joint.link)
        keys = (("ixx", 0, 0), ("ixy", 0, 1), ("iyy", 1, 1), ("ixz", 0, 2), ("iyz", 1, 2))
        data["link"] = {
            "mass": float(body.mass),
            "com": _numbers(body.com),
            "inertia": {
                name: float(body.inertia[i, j]) + 0.0 for name, i, j in (*keys, ("izz", 2, 2))
            },
        }
    return data
