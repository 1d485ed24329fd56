"""The bundled robots.

`lieid_casadi.Robot.load` and the command line accept these names. Their YAML files name sources.
"""

from __future__ import annotations

from lieid_casadi.robot import Robot

__all__ = ["panda", "panda_luo2024", "so101", "two_link"]


def panda() -> Robot:
    """Return the Franka Emika Panda: Franka's zero pose and limits, published inertias, no hand.

    Inertias are those of Gaz et al., IEEE RA-L 4(4), 2019; the tool is the flange.
    """
    return Robot.load("panda")


def panda_luo2024() -> Robot:
    """Return the Panda with the screws, zero pose and ranges of Luo et al. 2024, Table II.

    The same arm as `panda`, with other joint angles for the same pose:
    q4 = q4_Franka + π/2, q6 = q6_Franka − π/2.
    """
    return Robot.load("panda_luo2024")


def so101() -> Robot:
    """Return the SO-101 follower arm, the gripper's jaw being the sixth joint.

    From TheRobotStudio's URDF (Apache License 2.0), with the inertias of its CAD model. Its drives
    are not stated: give a servo, such as ``robot.with_drives(lieid.servo_drive("sts3215"))``.
    """
    return Robot.load("so101")


def two_link() -> Robot:
    """Return a planar arm in the vertical plane with round numbers, for teaching.

    Links of 0.5 m and 0.4 m, 2 kg and 1 kg with the centres of mass half-way, stretched along x at
    the zero pose; positive angles lift them.
    """
    return Robot.load("two_link")
