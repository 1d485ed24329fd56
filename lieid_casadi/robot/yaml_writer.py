"""A robot as YAML text."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from lieid_casadi.robot.inertia import body_inertia
from lieid_casadi.robot.joint import Joint, RobotDescription
from lieid_casadi.robot.pose import roll_pitch_yaw


def write_yaml(robot: RobotDescription) -> str:
    """Return the YAML of a robot; `lieid_casadi.robot.yaml_file` reads it back, to round-off.

    The names of links and the text from which the robot was read are not part of it.
    """
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
    if joint.drive is not None and not joint.drive.relative:
        law = {"stiffness": joint.drive.stiffness, "damping": joint.drive.damping}
        data["drive"] = {"servo": joint.drive.servo} if joint.drive.servo else law
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
