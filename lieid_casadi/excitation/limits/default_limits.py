"""Limits that a design checks by default, and the limits that it does not check."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.excitation.limits.capsules import Capsule
from lieid_casadi.excitation.limits.link_geometry import capsules_of
from lieid_casadi.excitation.limits.symbolic_limits import CartesianSpeed, Limit, Torque
from lieid_casadi.excitation.limits.workspace import SelfCollision, Wall, floor
from lieid_casadi.robot.robot import Robot

MARGIN = 0.8  # part of the velocity and torque limits that a design uses
TOOL_SPEED = 1.5  # m/s
FLOOR = 0.0  # m, base frame
CLEARANCE = 0.02  # m, between links


def default_limits(
    robot: Robot,
    *,
    margin: float = MARGIN,
    floor_height: float | None = FLOOR,
    cartesian_speed: float | None = TOOL_SPEED,
    clearance: float | None = CLEARANCE,
    capsules: Sequence[Capsule] | None = None,
) -> tuple[Limit, ...]:
    """Return the limits besides those of the joints; None leaves a limit out.

    Parameters
    ----------
    robot : Robot
    margin : float
        Part of the torque limits, where the robot states inertias and torque limits.
    floor_height : float or None
        Height of the floor in the base frame, m.
    cartesian_speed : float or None
        Of the tool and the joint centres, m/s.
    clearance : float or None
        Between links, m.
    capsules : sequence of Capsule, optional
        Links. Default: those of `capsules_of`.
    """
    limits: list[Limit] = []
    if robot.has_inertia and np.isfinite(robot.limit("torque")).any():
        limits.append(Torque(margin))
    if cartesian_speed is not None:
        limits.append(CartesianSpeed(cartesian_speed))
    if floor_height is not None or clearance is not None:
        links = tuple(capsules_of(robot) if capsules is None else capsules)
        if floor_height is not None:
            limits.append(floor(floor_height, capsules=links))
        if clearance is not None:
            limits.append(SelfCollision(clearance, links))
    return tuple(limits)


def unchecked_limits(robot: Robot, limits: Sequence[Limit]) -> tuple[str, ...]:
    """Return the names of the limits that a design with these limits does not check."""
    unchecked: list[str] = []
    torque, position = robot.limit("torque"), robot.limit("position_lower")
    has_torque = any(isinstance(limit, Torque) for limit in limits)
    without = [j + 1 for j in range(robot.n) if not (has_torque and np.isfinite(torque[j]))]
    if without:
        unchecked.append(f"torque of {_joints(without, robot.n)}")
    if len(without) < robot.n:
        unchecked.append("torque of friction, payload and wrong inertias")
    endless = [j + 1 for j in range(robot.n) if not np.isfinite(position[j])]
    if endless:
        unchecked.append(f"position of {_joints(endless, robot.n)}")
    checked = {
        "tool speed": any(isinstance(limit, CartesianSpeed) for limit in limits),
        "floor": any(isinstance(limit, Wall) and limit.normal[2] < 0.0 for limit in limits),
        "self-collision": any(isinstance(limit, SelfCollision) for limit in limits),
    }
    unchecked += [name for name, is_checked in checked.items() if not is_checked]
    return (*unchecked, "surroundings other than the stated ones")


def _joints(numbers: list[int], n: int) -> str:
    if len(numbers) == n:
        return "every joint"
    return f"joint{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"
