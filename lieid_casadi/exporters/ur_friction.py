"""``lieid export FIT --to ur-friction``: friction for Universal Robots' direct torque control.

The driver's ``friction_model_controller`` takes no friction in N·m: the service
``set_friction_model_parameters`` (``ur_msgs/FrictionModelParameters``) scales, joint by joint and
from 0 to 1, the robot's own friction model, which ``direct_torque`` compensates.
"""

from __future__ import annotations

import yaml

from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.simulator_joints import (
    beyond_linear_friction,
    file_name,
    linear_friction,
)
from lieid_casadi.identification.fit import Fit

JOINTS = 6
HEAD = """\
# ros2 service call /friction_model_controller/set_friction_model_parameters \\
#   ur_msgs/srv/SetFrictionModelParameters "{parameters: {viscous_scale: [0, 0, 0, 0, 0, 0], coulomb_scale: [0, 0, 0, 0, 0, 0]}}"
"""  # noqa: E501


def ur_friction_files(fit: Fit) -> tuple[dict[str, bytes], list[str]]:
    """Return ``ROBOT_ur_friction.yaml``: the friction, and the scales of the robot's own model.

    The scales are 0, so that a controller adds the identified friction itself.

    Raises `ExportError`: not six joints.
    """
    robot = fit.model.robot
    if fit.model.n != JOINTS:
        raise ExportError(f"ur-friction: {robot.name} has {fit.model.n} joints; expected 6")
    friction = linear_friction(fit)
    notes = [
        "direct_torque compensates gravity itself: command torques without it",
        "the scales are 0: add the friction of this file to the commanded torque",
        *beyond_linear_friction(friction),
    ]
    data = {
        "parameters": {"viscous_scale": [0.0] * JOINTS, "coulomb_scale": [0.0] * JOINTS},
        "identified": {
            "joints": [joint.name for joint in robot.joints],
            "viscous": [own.damping for own in friction],
            "coulomb": [own.loss for own in friction],
            "units": {"viscous": "N·m·s/rad", "coulomb": "N·m"},
        },
    }
    text = HEAD + yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
    return {f"{file_name(robot.name)}_ur_friction.yaml": text.encode()}, notes
