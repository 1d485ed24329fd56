"""``lieid export FIT --to urdf``: the robot with the identified inertias, for simulators."""

from __future__ import annotations

import numpy as np

from lieid_casadi.exporters.isaaclab import isaac_joints
from lieid_casadi.exporters.simulator_joints import (
    SimulatorJoint,
    check_possible,
    file_name,
    left_out,
    negative,
    simulator_joints,
)
from lieid_casadi.exporters.urdf_bodies import edited_urdf, number, written_urdf
from lieid_casadi.exporters.xml_text import attribute, comment
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot import Robot
from lieid_casadi.robot.description import STANDARD_GRAVITY


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


ATTRIBUTES = (("armature", "armature"), ("damping", "damping"), ("friction", "frictionloss"))
HEAD = """\
<!-- Identified armature (kg·m²), damping (N·m·s/rad) and frictionloss (N·m) of {robot}.
     In an MJCF model: <include file="{file}"/> at the top, and class="identified_JOINT" on each
     <joint>; or copy the attributes onto the joints. -->
"""


def mjcf_snippet(fit: Fit, *, file: str) -> str:
    """Return an MJCF file with one default class per joint, ``identified_JOINT``, to include.

    ``file``: its name, which its comment shows.
    """
    robot = fit.model.robot
    lines = [
        HEAD.format(robot=comment(robot.name), file=comment(file)),
        "<mujocoinclude>\n  <default>\n",
    ]
    for joint, numbers in zip(robot.joints, simulator_joints(fit), strict=True):
        lines.append(f"    <default class={attribute('identified_' + joint.name)}>\n")
        lines.append(f"      <joint{_attributes(numbers)}/>\n    </default>\n")
    lines.append("  </default>\n</mujocoinclude>\n")
    return "".join(lines)


def _attributes(numbers: SimulatorJoint) -> str:
    values = ((name, getattr(numbers, place)) for place, name in ATTRIBUTES)
    return "".join(f' {name}="{number(value)}"' for name, value in values if value is not None)


def urdf_files(fit: Fit) -> tuple[dict[str, bytes], list[str]]:
    """Return ``ROBOT.urdf``, ``ROBOT_joints.xml`` (MuJoCo) and ``ROBOT_joints.yaml`` (Isaac Lab).

    The URDF is the one that the robot was read from, with the identified inertias and, where
    the model has them, viscous and Coulomb friction; everything else stays as it was. A robot
    from YAML gets a URDF written from its screws. The second result are notes.

    Raises `ExportError`: the fit's masses and inertias are not certified to be physically
    consistent; the message has the command that makes a fit whose are.
    """
    text, notes = urdf_text(fit)
    robot, name = fit.model.robot, file_name(fit.model.robot.name)
    return {
        f"{name}.urdf": with_ros2_control(text, robot).encode(),
        f"{name}_joints.xml": mjcf_snippet(fit, file=f"{name}_joints.xml").encode(),
        f"{name}_joints.yaml": isaac_joints(robot, simulator_joints(fit)).encode(),
    }, notes


def urdf_text(fit: Fit) -> tuple[str, list[str]]:
    """Return the URDF and notes on it; raises as `urdf_files`."""
    check_possible(fit)
    robot = fit.model.robot
    if robot.source is not None and robot.source.kind == "urdf":
        text, notes = edited_urdf(fit, robot.source.text)
    else:
        bodies = fit.link_parameters.reshape(-1, 10)
        text, notes = written_urdf(robot, bodies, simulator_joints(fit))
    left = left_out(fit, {"armature", "damping", "friction"})
    if any(numbers.armature is not None for numbers in simulator_joints(fit)):
        notes.append("URDF has no element for armature; it is in the MuJoCo file")
    if left:
        notes.append(
            f"not exported, because URDF and MuJoCo have no element for it: {', '.join(left)}"
        )
    if negative(fit):
        notes.append(f"written as 0 because it is negative: {', '.join(negative(fit))}")
    if not np.allclose(robot.gravity, STANDARD_GRAVITY, atol=1e-9):
        x, y, z = robot.gravity
        notes.append(f"URDF has no element for gravity; set it to ({x:g}, {y:g}, {z:g}) m/s²")
    return text, notes
