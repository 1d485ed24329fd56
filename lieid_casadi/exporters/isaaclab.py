"""``lieid export FIT --to isaaclab``: the identified joints as actuators of Isaac Lab and mjlab."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from lieid_casadi.exporters.simulator_joints import (
    PassiveTorques,
    actuator_law,
    beyond_linear_friction,
    file_name,
    left_out,
    linear_friction,
    passive_torques,
)
from lieid_casadi.exporters.xml_text import allowed
from lieid_casadi.identification.fit import Fit

HEAD = '''"""Joints of {robot}, identified by lieid-casadi {version}: SI units.

{notes}"""

from isaaclab.actuators import ImplicitActuatorCfg

# for isaaclab.assets.ArticulationCfg(actuators=ACTUATORS)
ACTUATORS = {{
    "arm": ImplicitActuatorCfg(
'''
MJLAB_HEAD = '''"""Joints of {robot}, identified by lieid-casadi {version}: SI units.

Body inertias and the damping of joints belong to the MuJoCo model (--to mjcf).

{notes}"""

from mjlab.actuator import {kinds}

# for mjlab.entity.EntityArticulationInfoCfg(actuators=ACTUATORS)
ACTUATORS = (
'''


def isaaclab_files(fit: Fit) -> tuple[dict[str, bytes], list[str]]:
    """Return ``ROBOT_isaaclab.py`` and ``ROBOT_mjlab.py``, and notes on their use.

    The first has an ``ImplicitActuatorCfg`` of all joints, the second a built-in actuator of each.
    Viscous and dry friction are those of `linear_friction`; from Isaac Sim 5.0 on its fields are
    efforts. Inertias belong to the URDF or the MuJoCo model.
    """
    from lieid_casadi import __version__

    robot, friction = fit.model.robot, linear_friction(fit)
    passive = [passive_torques(fit, j, own) for j, own in enumerate(friction)]
    notes = [
        "friction and dynamic_friction are efforts in Isaac Sim 5.0 and later, and coefficients "
        "without unit in 4.5",
        "Isaac Lab 3.0 calls effort_limit_sim and velocity_limit_sim joint_effort_limit and "
        "joint_velocity_limit; the names here work until 4.0",
        *beyond_linear_friction(friction),
    ]
    unknown = sorted(
        left_out(fit, friction=True, besides=("armature", "offset", "torque_saturation"))
    )
    if any(p.effect.name == "offset" for p in fit.model.placements):
        notes.append("not exported: the constant torque of offset")
    if unknown:
        notes.append(f"not exported: {', '.join(unknown)}")
    fields: dict[str, dict[str, float]] = {}
    for j, (joint, own) in enumerate(zip(robot.joints, passive, strict=True)):
        law = actuator_law(fit, j)
        values = {
            "stiffness": law.stiffness if law else 0.0,
            "damping": law.damping if law else 0.0,
            "armature": own.armature,
            "friction": own.frictionloss,
            "dynamic_friction": own.frictionloss,
            "viscous_friction": own.damping,
            "effort_limit_sim": law.force if law else joint.limits.torque,
            "velocity_limit_sim": joint.limits.velocity,
        }
        for name, value in values.items():
            if math.isfinite(value):
                fields.setdefault(name, {})[re.escape(joint.name)] = float(value)
    names = [re.escape(joint.name) for joint in robot.joints]
    lines = [f"        joint_names_expr={names!r},"]
    lines += [f"        {name}={values!r}," for name, values in fields.items()]
    title = " ".join(_in_docstring(allowed(robot.name)).split())
    head = HEAD.format(robot=title, version=__version__, notes=_listed(notes))
    text = head + "\n".join(lines) + "\n    ),\n}\n"
    of_mjlab = [
        f"mjlab has no field for viscous friction, {own.damping:.4g} N·m·s/rad of joint {j + 1}: "
        "it is the damping of the joint in the MuJoCo model"
        for j, own in enumerate(passive)
        if own.damping
    ]
    of_mjlab += [
        f"joint {j + 1} states no torque limit, which a motor of mjlab needs: add effort_limit"
        for j, joint in enumerate(robot.joints)
        if joint.drive is None and not math.isfinite(joint.limits.torque)
    ]
    kinds, actuators = _mjlab_actuators(fit, passive)
    of_motors = notes[2:] + of_mjlab
    mjlab = MJLAB_HEAD.format(
        robot=title, version=__version__, notes=_listed(of_motors), kinds=", ".join(kinds)
    )
    name = file_name(robot.name)
    files = {f"{name}_isaaclab.py": text.encode()}
    files[f"{name}_mjlab.py"] = (mjlab + "\n".join(actuators) + "\n)\n").encode()
    return files, [*notes, *of_mjlab]


def _in_docstring(text: str) -> str:
    return text.replace("\\", "/").replace('"', "'")


def _listed(notes: Sequence[str]) -> str:
    return _in_docstring("\n".join(f"- {note}" for note in notes))


def _mjlab_actuators(fit: Fit, passive: Sequence[PassiveTorques]) -> tuple[list[str], list[str]]:
    """Return the mjlab classes that are used, and a line for each joint, by its drive law."""
    kinds, lines = set[str](), []
    for j, (joint, own) in enumerate(zip(fit.model.robot.joints, passive, strict=True)):
        law = actuator_law(fit, j)
        kind, fields = "BuiltinMotorActuatorCfg", {"effort_limit": joint.limits.torque}
        if law is not None:
            kind = "BuiltinPositionActuatorCfg"
            fields = {"stiffness": law.stiffness, "damping": law.damping, "effort_limit": law.force}
        fields |= {"armature": own.armature, "frictionloss": own.frictionloss}
        kinds.add(kind)
        stated = {name: repr(float(x)) for name, x in fields.items() if math.isfinite(x)}
        words = ", ".join(f"{name}={text}" for name, text in stated.items())
        lines.append(f"    {kind}(target_names_expr=({re.escape(joint.name)!r},), {words}),")
    return sorted(kinds), lines
