"""Interfaces of joints for ros2_control, and drive gains as Isaac Lab takes them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import yaml

from lieid_casadi.exporters.joint_friction import SimulatorJoint
from lieid_casadi.exporters.xml_text import attribute
from lieid_casadi.robot import Robot


def with_ros2_control(urdf: str, robot: Robot) -> str:
    """Return the URDF of a position-controlled robot with ``ros2_control``, unless it has it.

    The hardware is ros2_control's mock component; replace its plugin by that of the arm. The URDF
    of a robot without drives stays as it is.
    """
    end = urdf.rfind("</robot>")
    if robot.drives is None or "<ros2_control" in urdf or end < 0:
        return urdf
    lines = [
        f'  <ros2_control name={attribute(robot.name)} type="system">',
        "    <hardware><plugin>mock_components/GenericSystem</plugin></hardware>",
    ]
    for joint in robot.joints:
        lines += [
            f"    <joint name={attribute(joint.name)}>",
            '      <command_interface name="position"/>',
            *(f'      <state_interface name="{x}"/>' for x in ("position", "velocity", "effort")),
            "    </joint>",
        ]
    lines += ["  </ros2_control>", ""]
    return urdf[:end] + "\n".join(lines) + urdf[end:]


def isaac_joints(robot: Robot, joints: Sequence[SimulatorJoint]) -> str:
    """Return YAML with the fields of Isaac Lab's ``ImplicitActuatorCfg`` for every joint.

    ``joints``: one per joint of the robot. Isaac Lab's friction is a coefficient without unit, so
    that dry friction is stated under another name.
    """
    data = {}
    for joint, numbers in zip(robot.joints, joints, strict=True):
        law = None if joint.drive is None else joint.drive.limited(joint.limits.torque)
        limit = joint.limits.torque
        if law is not None:
            limit = min(law.torque_limit, law.proportional_limit)
        viscous = numbers.damping or 0.0
        fields = {
            "stiffness": 0.0 if law is None else law.stiffness,
            "damping": viscous + (0.0 if law is None else law.damping),
            "armature": numbers.armature or 0.0,
            "effort_limit_sim": limit if math.isfinite(limit) else None,
            "coulomb_friction_torque": numbers.friction or 0.0,
        }
        data[joint.name] = {k: v if v is None else float(v) for k, v in fields.items()}
    head = "# Fields of isaaclab.actuators.ImplicitActuatorCfg per joint; N·m, rad, s.\n"
    return head + str(yaml.safe_dump(data, sort_keys=False, allow_unicode=True))
