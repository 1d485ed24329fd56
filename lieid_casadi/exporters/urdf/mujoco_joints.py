"""Armature, damping and dry friction for MuJoCo, which does not read armature from URDF."""

from __future__ import annotations

from lieid_casadi.exporters.joint_friction import SimulatorJoint, simulator_joints
from lieid_casadi.exporters.urdf.bodies import number
from lieid_casadi.exporters.xml_text import attribute, comment
from lieid_casadi.identification.fit import Fit

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
