"""The bundled robots.

`lieid_casadi.Robot.load` and the command line accept these names. Their YAML files name the source
of every number.
"""

from __future__ import annotations

from lieid_casadi.robot import Robot

__all__ = ["panda", "panda_luo2024", "so101", "two_link"]


def panda() -> Robot:
    """Return the Franka Emika Panda: Franka's zero pose and limits, published inertias, no hand.

    Inertias are those of Gaz et al., IEEE RA-L 4(4), 2019; the tool is the flange.

    Examples
    --------
    >>> robot = panda()
    >>> robot.n, robot.has_inertia
    (7, True)
    >>> robot.tool[:3, 3]
    array([0.   , 0.   , 0.107])
    """
    return Robot.load("panda")


def panda_luo2024() -> Robot:
    """Return the Panda with the screws, zero pose and ranges of Luo et al. 2024, Table II.

    The same arm as `panda`, with other joint angles for the same pose:
    q4 = q4_Franka + π/2, q6 = q6_Franka − π/2.

    Examples
    --------
    >>> robot = panda_luo2024()
    >>> robot.joints[4].screw  # the fifth joint lies along the base's x axis
    array([1.    , 0.    , 0.    , 0.    , 0.7315, 0.    ])
    """
    return Robot.load("panda_luo2024")


def so101() -> Robot:
    """Return the SO-101 follower arm, the gripper's jaw being the sixth joint.

    From TheRobotStudio's URDF (Apache License 2.0), with the inertias of its CAD model. Its drives
    are not stated: give a servo, such as ``robot.with_drives(lieid.servo_drive("sts3215"))``.

    Examples
    --------
    >>> [joint.name for joint in so101().joints]
    ['shoulder_pan', 'shoulder_lift', 'elbow_flex', 'wrist_flex', 'wrist_roll', 'gripper']
    """
    return Robot.load("so101")


def two_link() -> Robot:
    """Return a planar arm in the vertical plane with round numbers, for teaching.

    Links of 0.5 m and 0.4 m, 2 kg and 1 kg with the centres of mass half-way, stretched along x at
    the zero pose; positive angles lift them.

    Examples
    --------
    >>> robot = two_link()
    >>> [joint.name for joint in robot.joints]
    ['shoulder', 'elbow']
    >>> robot.link_parameters[:2]  # mass and m·c_x of the first link
    array([2. , 0.5])
    """
    return Robot.load("two_link")
