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
        drive: {stiffness: 20, damping: 0.5}  # N·m/rad, N·m·s/rad; or {servo: sts3215}
        link:
          mass: 3.0
          com: [0.1, 0, 0]            # in the link frame
          inertia: {ixx: 0.02, ixy: 0, iyy: 0.03, ixz: 0, iyz: 0, izz: 0.03}
    tool: {xyz: [0.2, 0, 0], rpy: [0, 0, 0]}

``name``, ``joints`` and each joint's ``name`` and ``screw`` are required; the rest is optional.

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

import numpy as np
import yaml

from lieid_casadi.arrays import Array
from lieid_casadi.errors import NominalInertiaWarning, RobotError
from lieid_casadi.robot.description import (
    MOST_JOINTS,
    NOT_STATED,
    STANDARD_GRAVITY,
    Joint,
    Limits,
    RobotDescription,
    RobotSource,
)
from lieid_casadi.robot.drive import Drive, servo_drive
from lieid_casadi.robot.inertia import (
    body_inertia,
    impossible_moments,
    link_parameters,
    pose,
    roll_pitch_yaw,
    symmetric,
)
from lieid_casadi.robot.yaml_text import FARTHEST, Field

# Accepts seven printed digits of a unit vector, but no wrong axis.
SCREW_TOLERANCE = 1e-6


def read_yaml(text: str, *, origin: str = "YAML") -> RobotDescription:
    """Return the serial arm that a YAML text describes (keys: see the module).

    Examples
    --------
    >>> robot = read_yaml("{name: one, joints: [{name: turn, screw: [0, 0, 1, 0, 0, 0]}]}")
    >>> robot.joints[0].revolute
    True
    """
    top = Field.top(text, origin).mapping(("name", "joints"), ("gravity", "tool"))
    items = top["joints"].items()
    if not 1 <= len(items) <= MOST_JOINTS:
        found = f"a list of {len(items)}" if items else "an empty list"
        raise top["joints"].error(f"at least one joint and at most {MOST_JOINTS}", found=found)
    names: dict[str, int] = {}
    joints: list[Joint] = []
    warnings: list[NominalInertiaWarning] = []
    for index, item in enumerate(items):
        keys = item.mapping(
            ("name", "screw"), ("home", "limits", "torque_constant", "drive", "link")
        )
        name = keys["name"].text()
        if name in names:
            raise keys["name"].error(
                "a unique name", found=f"{name!r}, the name of joint {names[name] + 1}"
            )
        names[name] = index
        joints.append(_joint(name, keys))
        fault = impossible_moments(joints[-1].link)
        if fault is not None:
            warnings.append(
                NominalInertiaWarning(
                    f"{origin}: joint {index + 1} ({name}): the inertia of its link has {fault} "
                    "which is physically impossible"
                )
            )
    return RobotDescription(
        name=top["name"].text(),
        joints=tuple(joints),
        gravity=top["gravity"].numbers(3) if "gravity" in top else np.array(STANDARD_GRAVITY),
        tool=_pose(top.get("tool")),
        source=RobotSource("yaml", text),
        warnings=tuple(warnings),
    )


def _joint(name: str, keys: dict[str, Field]) -> Joint:
    constant = NOT_STATED
    if "torque_constant" in keys:
        constant = keys["torque_constant"].number()
        if constant == 0.0:
            raise keys["torque_constant"].error("N·m/A other than 0")
    return Joint(
        name=name,
        screw=_screw(keys["screw"]),
        home=_pose(keys.get("home")),
        limits=_limits(keys["limits"]) if "limits" in keys else Limits(),
        link=_link(keys["link"]) if "link" in keys else None,
        torque_constant=constant,
        drive=_drive(keys["drive"]) if "drive" in keys else None,
    )


def _drive(field: Field) -> Drive:
    keys = field.mapping((), ("stiffness", "damping", "servo"))
    damping = keys["damping"].number() if "damping" in keys else 0.0
    if damping < 0.0:
        raise keys["damping"].error("N·m·s/rad, not negative")
    if "servo" in keys:
        if "stiffness" in keys:
            raise field.error("servo, or stiffness, not both")
        try:
            return servo_drive(keys["servo"].text(), derivative=damping)
        except RobotError as error:
            raise keys["servo"].error(str(error).rpartition("expected ")[2]) from None
    if "stiffness" not in keys:
        raise field.error("the keys stiffness and damping, or servo")
    return Drive(stiffness=keys["stiffness"].positive(), damping=damping)


def _pose(field: Field | None) -> Array:
    keys = {} if field is None else field.mapping((), ("xyz", "rpy"))
    xyz, rpy = (
        keys[name].numbers(3, largest=FARTHEST) if name in keys else np.zeros(3)
        for name in ("xyz", "rpy")
    )
    return pose(xyz, rpy)


def _screw(field: Field) -> Array:
    """Return the unit twist (6,), without the rounding of the file."""
    screw = field.numbers(6, largest=FARTHEST)
    omega, v = screw[:3], screw[3:]
    if not omega.any():
        length = float(np.linalg.norm(v))
        if abs(length - 1.0) > SCREW_TOLERANCE:
            raise field.error(
                "|v| = 1: divide v by its length, or state ω for a revolute joint",
                found=f"ω = 0 (a prismatic joint) and |v| = {length:.9g}",
            )
        return np.concatenate([omega, v / length])
    length = float(np.linalg.norm(omega))
    if abs(length - 1.0) > SCREW_TOLERANCE:
        raise field.error(
            "1 (revolute) or ω = 0 (prismatic): divide the six numbers by |ω|",
            found=f"|ω| = {length:.9g}",
        )
    pitch = float(omega @ v)
    if abs(pitch) > SCREW_TOLERANCE * max(1.0, float(np.linalg.norm(v))):
        raise field.error(
            "0: a revolute joint through the point p has v = −ω × p", found=f"ω·v = {pitch:.9g}"
        )
    omega = omega / length
    return np.concatenate([omega, v - (omega @ v) * omega])


def _limits(field: Field) -> Limits:
    keys = field.mapping((), ("position", "velocity", "acceleration", "torque"))
    lower = upper = NOT_STATED
    if "position" in keys:
        lower, upper = (float(x) for x in keys["position"].numbers(2))
        if not lower < upper:
            raise keys["position"].error("[lower, upper] with lower < upper")
    velocity, acceleration, torque = (
        keys[name].positive() if name in keys else NOT_STATED
        for name in ("velocity", "acceleration", "torque")
    )
    return Limits(lower, upper, velocity, acceleration, torque)


def _link(field: Field) -> Array:
    keys = field.mapping(("mass", "com", "inertia"))
    mass = keys["mass"].number()
    if mass < 0.0:
        raise keys["mass"].error("kg, not negative")
    com = keys["com"].numbers(3, largest=FARTHEST)
    return link_parameters(mass, com, read_inertia(keys["inertia"]))


def read_inertia(field: Field) -> Array:
    """Return the inertia (3, 3) about the centre of mass, from any of its three forms."""
    if isinstance(field.value, dict):
        keys = field.mapping(("ixx", "iyy", "izz"), ("ixy", "ixz", "iyz"))
        order = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
        return symmetric([keys[name].number() if name in keys else 0.0 for name in order])
    rows = field.value if isinstance(field.value, list) else []
    if len(rows) == 6:
        return symmetric(field.numbers(6))
    if len(rows) != 3 or not all(isinstance(row, list) and len(row) == 3 for row in rows):
        raise field.error(
            "ixx, ixy, iyy, ixz, iyz, izz as a mapping or in this order, or a 3×3 matrix"
        )
    matrix = np.array([row.numbers(3) for row in field.items()])
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
        raise field.error("a symmetric matrix", found="a matrix that is not symmetric")
    return np.asarray(0.5 * (matrix + matrix.T))


def write_yaml(robot: RobotDescription) -> str:
    """Return the YAML of a robot, without the names of links; `read_yaml` reads it back."""
    data = {
        "name": robot.name,
        "gravity": _numbers(robot.gravity),
        "joints": [_joint_as_dict(joint) for joint in robot.joints],
        "tool": _pose_as_dict(robot.tool),
    }
    return str(
        yaml.safe_dump(
            data, sort_keys=False, default_flow_style=None, allow_unicode=True, width=1000
        )
    )


def _numbers(values: Array) -> list[float]:
    return [float(value) + 0.0 for value in values]  # no -0.0


def _pose_as_dict(matrix: Array) -> dict[str, list[float]]:
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
    if joint.drive is not None and not joint.drive.relative:
        own = joint.drive
        law: dict[str, Any] = {"stiffness": own.stiffness, "damping": own.damping}
        if own.servo:
            law = {"servo": own.servo} | ({"damping": own.derivative} if own.derivative else {})
        data["drive"] = law
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
