"""Effects of a model whose user names none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieid_casadi.recording import Recording
from lieid_casadi.recording.conversion import is_torque_of_laws
from lieid_casadi.robot.robot import Robot

JOINT_SIDE = ("coulomb", "viscous", "offset")
MOTOR_SIDE = (*JOINT_SIDE, "armature")
ENOUGH_ROWS = 1000  # that show where the torque of a recording comes from


@dataclass(frozen=True)
class DefaultEffects:
    """Effects of a model whose user names none."""

    names: tuple[str, ...]
    reason: str = ""  # why rotor inertia is among them; empty if it is not


def default_effects(
    robot: Robot, recordings: Sequence[Recording], *, motor_side: bool = False
) -> DefaultEffects:
    """Return Coulomb and viscous friction and offset, with rotor inertia for motor-side torque.

    Torque from motor currents or from the control law of position-controlled drives contains the
    torque that accelerates the rotors, which a sensor at the joint does not measure; ``motor_side``
    states it for others.

    Examples
    --------
    >>> import lieid_casadi as lieid
    >>> default_effects(lieid.robots.two_link(), []).names
    ('coulomb', 'viscous', 'offset')
    """
    if motor_side:
        return DefaultEffects(MOTOR_SIDE, "torque is measured at the motors")
    if any(recording.torque_constants is not None for recording in recordings):
        return DefaultEffects(MOTOR_SIDE, "torque is computed from motor currents")
    if np.isfinite(robot.torque_constants).any():
        return DefaultEffects(MOTOR_SIDE, "the robot states torque constants of its motors")
    if any(_from_law(robot, recording) for recording in recordings):
        return DefaultEffects(MOTOR_SIDE, "torque follows from the control law of the drives")
    return DefaultEffects(JOINT_SIDE)


def _from_law(robot: Robot, recording: Recording) -> bool:
    """Return whether the torque of a recording is that of the robot's control laws."""
    part = recording.rows(0, min(len(recording), ENOUGH_ROWS))
    return robot.drives is not None and is_torque_of_laws(part, robot.drives)
