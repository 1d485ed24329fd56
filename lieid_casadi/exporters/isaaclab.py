"""``lieid export FIT --to isaaclab``: the identified joints as Isaac Lab's implicit actuators."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from lieid_casadi.exporters.simulator_joints import (
    SimulatorJoint,
    beyond_linear_friction,
    file_name,
    left_out,
    linear_friction,
    simulator_joints,
)
from lieid_casadi.exporters.xml_text import allowed
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot import Joint, Robot

HEAD = '''"""Joints of {robot}, identified by lieid-casadi {version}: SI units.

{notes}"""

from isaaclab.actuators import ImplicitActuatorCfg

# for isaaclab.assets.ArticulationCfg(actuators=ACTUATORS)
ACTUATORS = {{
    "arm": ImplicitActuatorCfg(
'''
EXPRESSED = {"armature", "damping", "friction"}


def isaaclab_files(fit: Fit) -> tuple[dict[str, bytes], list[str]]:
    """Return ``ROBOT_isaaclab.py`` with an ``ImplicitActuatorCfg``, and notes on its use.

    Viscous and dry friction are those of `linear_friction`; from Isaac Sim 5.0 on its fields are
    efforts. Inertias belong to the URDF (``--to urdf``).
    """
    from lieid_casadi import __version__

    robot, friction = fit.model.robot, linear_friction(fit)
    notes = [
        "friction and dynamic_friction are efforts in Isaac Sim 5.0 and later, and coefficients "
        "without unit in 4.5",
        "Isaac Lab 3.0 calls effort_limit_sim and velocity_limit_sim joint_effort_limit and "
        "joint_velocity_limit; the names here work until 4.0",
        *beyond_linear_friction(friction),
    ]
    unknown = sorted(set(left_out(fit, EXPRESSED)) - {"offset", *_of_friction(fit)})
    if any(p.effect.name == "offset" for p in fit.model.placements):
        notes.append("not exported: the constant torque of offset")
    if unknown:
        notes.append(f"not exported: {', '.join(unknown)}")
    fields: dict[str, dict[str, float]] = {}
    for joint, numbers, own in zip(robot.joints, simulator_joints(fit), friction, strict=True):
        stiffness, damping, limit = _drive_of(joint)
        values = {
            "stiffness": stiffness,
            "damping": damping,
            "armature": numbers.armature or 0.0,
            "friction": own.loss,
            "dynamic_friction": own.loss,
            "viscous_friction": own.damping,
            "effort_limit_sim": limit,
            "velocity_limit_sim": joint.limits.velocity,
        }
        for name, value in values.items():
            if math.isfinite(value):
                fields.setdefault(name, {})[re.escape(joint.name)] = float(value)
    names = [re.escape(joint.name) for joint in robot.joints]
    lines = [f"        joint_names_expr={names!r},"]
    lines += [f"        {name}={values!r}," for name, values in fields.items()]
    shown = "\n".join(f"- {note}" for note in notes).replace("\\", "/").replace('"', "'")
    title = allowed(robot.name).replace("\\", "/").replace('"', "'")
    head = HEAD.format(robot=" ".join(title.split()), version=__version__, notes=shown)
    text = head + "\n".join(lines) + "\n    ),\n}\n"
    return {f"{file_name(robot.name)}_isaaclab.py": text.encode()}, notes


def _drive_of(joint: Joint) -> tuple[float, float, float]:
    """Return stiffness, damping and torque limit of a joint's drive; 0 where it has none."""
    if joint.drive is None:
        return 0.0, 0.0, joint.limits.torque
    law = joint.drive.limited(joint.limits.torque)
    return law.stiffness, law.damping, min(law.torque_limit, law.proportional_limit)


def _of_friction(fit: Fit) -> set[str]:
    """Return the names of effects that depend on velocity, which `linear_friction` contains."""
    return {p.effect.name for p in fit.model.placements if {"dq", "sign"} & set(p.effect.signals)}


def isaac_joints(robot: Robot, joints: Sequence[SimulatorJoint]) -> str:
    """Return YAML with the drives and the identified numbers of every joint."""
    import yaml

    data = {}
    for joint, numbers in zip(robot.joints, joints, strict=True):
        stiffness, damping, limit = _drive_of(joint)
        fields = {
            "stiffness": stiffness,
            "damping": (numbers.damping or 0.0) + damping,
            "armature": numbers.armature or 0.0,
            "effort_limit_sim": limit if math.isfinite(limit) else None,
            "coulomb_friction_torque": numbers.friction or 0.0,
        }
        data[joint.name] = {k: v if v is None else float(v) for k, v in fields.items()}
    head = "# Fields of isaaclab.actuators.ImplicitActuatorCfg per joint; N·m, rad, s.\n"
    return head + str(yaml.safe_dump(data, sort_keys=False, allow_unicode=True))
