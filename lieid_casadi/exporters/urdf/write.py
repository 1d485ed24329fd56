"""A URDF written from screws, for robots that were not read from a URDF."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.exporters.joint_friction import SimulatorJoint
from lieid_casadi.exporters.urdf.bodies import inertial_text, number
from lieid_casadi.exporters.xml_text import attribute
from lieid_casadi.robot import Joint, Robot
from lieid_casadi.robot.geometry import roll_pitch_yaw
from lieid_casadi.robot.inertia import parameter_transport

ON_AXIS = 1e-12  # m
REACH = 1e3  # m, limit of prismatic joints without limits, which URDF requires


def written_urdf(
    robot: Robot, bodies: Array, frictions: Sequence[SimulatorJoint]
) -> tuple[str, list[str]]:
    """Return a URDF of a robot, and notes on differences.

    Link frames are those of the robot; the origin is moved onto the axis of the joint if it is
    not on it.

    ``bodies`` (n, 10): link parameters in the robot's link frames; ``frictions``: one per joint.
    """
    names = _link_names(robot)
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<robot name={attribute(robot.name)}>",
        f"  <link name={attribute(names[0])}/>",
    ]
    notes, before = [], np.eye(4)
    for i, (joint, body, friction) in enumerate(zip(robot.joints, bodies, frictions, strict=True)):
        shift, back = np.eye(4), np.eye(4)
        shift[:3, 3] = _point_on_axis(joint)
        back[:3, 3] = -shift[:3, 3]
        frame = np.asarray(joint.home @ shift)
        lines += _link(names[i + 1], parameter_transport(back) @ body)
        lines += _joint(joint, _relative_pose(before, frame), names[i : i + 2], friction)
        before = frame
        if np.any(shift[:3, 3]):
            notes.append(f"{names[i + 1]}: its frame was moved onto the axis of {joint.name}")
    tool = _relative_pose(before, robot.joints[-1].home @ robot.tool)
    lines += [f"  <link name={attribute(names[-1])}/>"]
    lines += [f'  <joint name={attribute(names[-1] + "_joint")} type="fixed">']
    lines += [*_between(tool, names[-2:]), "  </joint>", "</robot>", ""]
    return "\n".join(lines), notes


def _relative_pose(frame: Array, pose: Array) -> Array:
    return np.asarray(np.linalg.solve(frame, pose))


def _point_on_axis(joint: Joint) -> Array:
    """Return the point of a joint's axis (3,) next to the origin of its link frame."""
    omega, v = joint.axis[:3], joint.axis[3:]
    if not joint.revolute:
        return np.zeros(3)
    point = np.cross(omega, v)
    return point if np.linalg.norm(point) > ON_AXIS else np.zeros(3)


def _link(name: str, body: Array) -> list[str]:
    inertial = inertial_text(body).replace("\n", "\n    ")
    return [f"  <link name={attribute(name)}>", f"    {inertial}", "  </link>"]


def _joint(joint: Joint, place: Array, names: Sequence[str], friction: SimulatorJoint) -> list[str]:
    limits = joint.limits
    bounded = np.isfinite(limits.position_lower) and np.isfinite(limits.position_upper)
    axis = joint.axis[:3] if joint.revolute else joint.axis[3:]
    kind = "prismatic" if not joint.revolute else "revolute" if bounded else "continuous"
    lines = [f'  <joint name={attribute(joint.name)} type="{kind}">']
    lines += _between(place, names)
    lines.append(f'    <axis xyz="{_numbers(axis)}"/>')
    stated = {"effort": limits.torque, "velocity": limits.velocity}
    if kind != "continuous":
        low, high = (limits.position_lower, limits.position_upper) if bounded else (-REACH, REACH)
        stated |= {"lower": low, "upper": high}
    if kind != "continuous" or np.isfinite(limits.torque) or np.isfinite(limits.velocity):
        written = "".join(
            f' {name}="{number(value) if np.isfinite(value) else 0}"'
            for name, value in stated.items()
        )
        lines.append(f"    <limit{written}/>")
    numbers = (("damping", friction.damping), ("friction", friction.friction))
    written = "".join(f' {name}="{number(x)}"' for name, x in numbers if x is not None)
    if written:
        lines.append(f"    <dynamics{written}/>")
    return [*lines, "  </joint>"]


def _between(place: Array, names: Sequence[str]) -> list[str]:
    rpy = roll_pitch_yaw(place[:3, :3])
    return [
        f'    <origin xyz="{_numbers(place[:3, 3])}" rpy="{_numbers(rpy)}"/>',
        f"    <parent link={attribute(names[0])}/>",
        f"    <child link={attribute(names[1])}/>",
    ]


def _link_names(robot: Robot) -> list[str]:
    """Return names of the base, the links and the tool, all different."""
    wanted = ["base", *(j.link_name or f"{j.name}_link" for j in robot.joints), "tool"]
    names: list[str] = []
    for name in wanted:
        while name in names:
            name += "_"
        names.append(name)
    return names


def _numbers(values: Array) -> str:
    return " ".join(number(x) for x in values)
