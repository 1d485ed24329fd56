"""``lieid export FIT --to ur-friction``: friction for Universal Robots' direct torque control.

The driver's ``friction_model_controller`` takes no friction in N·m: the service
``set_friction_model_parameters`` (``ur_msgs/FrictionModelParameters``) scales, joint by joint and
from 0 to 1, the robot's own friction model, which ``direct_torque`` compensates.
"""

from __future__ import annotations

import numpy as np
import yaml

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.simulator_joints import (
    beyond_linear_friction,
    file_name,
    linear_friction,
)
from lieid_casadi.identification.fit import Fit

JOINTS = 6
#: Scales of `direct_torque` where a program states none: URScript manual 5.25, ur_msgs 2.5.
DEFAULT_VISCOUS = (0.9, 0.9, 0.8, 0.9, 0.9, 0.9)
DEFAULT_COULOMB = (0.8, 0.8, 0.7, 0.8, 0.8, 0.8)
HEAD = """\
# ros2 service call /friction_model_controller/set_friction_model_parameters \\
#   ur_msgs/srv/SetFrictionModelParameters "{{parameters: {{viscous_scale: {viscous}, coulomb_scale: {coulomb}}}}}"
"""  # noqa: E501


def ur_friction_files(
    fit: Fit, compensated: Fit | None = None
) -> tuple[dict[str, bytes], list[str]]:
    """Return ``ROBOT_ur_friction.yaml``: scales for the robot's controller, and the friction.

    Of a fit alone the scales are 0, so that a controller adds the identified friction itself.
    ``compensated`` is a fit of a recording under direct torque control with the robot's default
    scales s: with friction f of ``fit`` (recorded without compensation, or as motor torque) and r
    of ``compensated``, the robot's own model is (f − r)/s, and the scale s·f/(f − r) compensates
    all of it.

    Raises `ExportError`: not six joints.
    """
    robot = fit.model.robot
    if fit.model.n != JOINTS or (compensated is not None and compensated.model.n != JOINTS):
        raise ExportError(f"ur-friction: {robot.name} has {fit.model.n} joints; expected 6")
    friction = linear_friction(fit)
    viscous = np.array([own.damping for own in friction])
    coulomb = np.array([own.loss for own in friction])
    notes = ["direct_torque compensates gravity itself: command torques without it"]
    if compensated is None:
        viscous_scale = coulomb_scale = np.zeros(JOINTS)
        notes.append(
            "the scales are 0: add the friction of this file to the commanded torque. Scales of "
            "the robot's own friction model need a second fit, under direct torque with the "
            "default scales (compensated=)"
        )
    else:
        rest = linear_friction(compensated)
        viscous_scale = _scale(viscous, np.array([r.damping for r in rest]), DEFAULT_VISCOUS)
        coulomb_scale = _scale(coulomb, np.array([r.loss for r in rest]), DEFAULT_COULOMB)
    notes += beyond_linear_friction(friction)
    scales = {
        "viscous_scale": [round(float(x), 3) for x in viscous_scale],
        "coulomb_scale": [round(float(x), 3) for x in coulomb_scale],
    }
    data = {
        "parameters": scales,
        "identified": {
            "joints": [joint.name for joint in robot.joints],
            "viscous": viscous.tolist(),
            "coulomb": coulomb.tolist(),
            "units": {"viscous": "N·m·s/rad", "coulomb": "N·m"},
        },
    }
    head = HEAD.format(viscous=scales["viscous_scale"], coulomb=scales["coulomb_scale"])
    text = head + yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
    return {f"{file_name(robot.name)}_ur_friction.yaml": text.encode()}, notes


def _scale(whole: Array, rest: Array, given: tuple[float, ...]) -> Array:
    """Return the scale (6,) that compensates all friction, within 0 to 1; 1 if none was."""
    compensated = whole - rest
    scale = np.array(given) * whole / np.where(compensated > 0.0, compensated, np.nan)
    return np.clip(np.nan_to_num(scale, nan=1.0), 0.0, 1.0)
