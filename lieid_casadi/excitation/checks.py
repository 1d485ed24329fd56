"""Limits that a design checks by default, and the limits that it does not check."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.excitation.clearance import SelfCollision, Wall, floor
from lieid_casadi.excitation.limits import CartesianSpeed, ExpressionLimit, Limit, MotionRange
from lieid_casadi.excitation.links import Capsule, capsules_of, skeleton
from lieid_casadi.excitation.sample_functions import FittedArm
from lieid_casadi.excitation.torque_limit import Torque, torque_limits
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

    Returns
    -------
    tuple of Limit
        `Torque`, `CartesianSpeed`, `floor` and `SelfCollision`, as far as they apply.
    """
    limits: list[Limit] = []
    if robot.has_inertia and np.isfinite(torque_limits(robot)).any():
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


def checked_limits(
    joints: MotionRange, limits: Sequence[Limit], fit: FittedArm | None
) -> tuple[str, ...]:
    """Return a description of each limit that a design with these limits checks.

    Parameters
    ----------
    joints : MotionRange
    limits : sequence of Limit
        Besides those of the joints.
    fit : FittedArm or None
    """
    velocity, acceleration = _list(joints.velocity), _list(joints.acceleration)
    unit = "rad" if joints.revolute.all() else "rad or m"
    return (
        f"position, velocity ({velocity} {unit}/s) and acceleration ({acceleration} {unit}/s²) "
        "of joints",
        *(_description(limit, fit) for limit in limits),
    )


def _description(limit: Limit, fit: FittedArm | None) -> str:
    if isinstance(limit, Torque):
        part = f"torque within {limit.fraction:g} of its limits"
        if fit is not None:
            return (
                f"{part}, by the fit with all effects, ± {limit.deviations:g} standard deviations"
            )
        return (
            f"{part}, by the stated inertias, with {limit.dry:g} of the limit for friction and "
            f"up to {limit.viscous:g} more in proportion to the speed"
        )
    if isinstance(limit, CartesianSpeed):
        return f"speed of tool and joint centres up to {limit.limit:g} m/s"
    if isinstance(limit, Wall) and limit.name == "floor":
        return f"floor at {-limit.offset:g} m"
    if isinstance(limit, SelfCollision):
        return f"{limit.clearance:g} m between links that are not adjacent (capsules)"
    if isinstance(limit, ExpressionLimit):
        return f"{limit.name} of {_bounds(limit)} {limit.unit}".rstrip()
    return str(getattr(limit, "name", type(limit).__name__))


def _bounds(limit: ExpressionLimit) -> str:
    """Return the bounds of an expression in words."""
    lower, upper = (np.asarray(bound, dtype=float) for bound in (limit.lower, limit.upper))
    parts = [
        f"{word} {_list(np.atleast_1d(bound))}"
        for word, bound in (("at least", lower), ("at most", upper))
        if np.isfinite(bound).all()
    ]
    return " and ".join(parts)


def unchecked_limits(
    robot: Robot,
    limits: Sequence[Limit],
    left_out: Sequence[str] = (),
    fit: FittedArm | None = None,
) -> tuple[str, ...]:
    """Return the names of the limits that a design with these limits does not check.

    Parameters
    ----------
    robot : Robot
    limits : sequence of Limit
        Besides those of the joints.
    left_out : sequence of str
        Quantities that these limits leave out.
    fit : FittedArm, optional
    """
    unchecked: list[str] = []
    torque, position = torque_limits(robot), robot.limit("position_lower")
    has_torque = any(isinstance(limit, Torque) for limit in limits)
    without = [j + 1 for j in range(robot.n) if not (has_torque and np.isfinite(torque[j]))]
    if without:
        unchecked.append(f"torque of {_joints(without, robot.n)}")
    if len(without) < robot.n:
        unchecked.append(
            "torque of payloads and inertias other than the stated ones, and of friction above "
            "the allowance"
            if fit is None
            else "torque of payloads and temperatures other than in the recordings of the fit"
        )
    endless = [j + 1 for j in range(robot.n) if not np.isfinite(position[j])]
    if endless:
        unchecked.append(f"position of {_joints(endless, robot.n)}")
    checked = {
        "jerk": any(getattr(limit, "name", "") == "jerk" for limit in limits),
        "tool speed": any(isinstance(limit, CartesianSpeed) for limit in limits),
        "floor": any(isinstance(limit, Wall) and limit.normal[2] < 0.0 for limit in limits),
        "self-collision": any(isinstance(limit, SelfCollision) for limit in limits),
    }
    unchecked += [name for name, is_checked in checked.items() if not is_checked]
    if any(_is_skeleton(robot, getattr(limit, "capsules", None)) for limit in limits):
        unchecked.append(
            "shapes of links (no collision geometry was found: capsules follow the lines between "
            "joints; state capsules with --capsules)"
        )
    unchecked += [f"{label} (capsules too coarse)" for label in left_out]
    return (*unchecked, "surroundings other than the stated ones")


def _is_skeleton(robot: Robot, capsules: Sequence[Capsule] | None) -> bool:
    """Return whether capsules are those of `skeleton`, which () stands for; not for None."""
    if capsules is None:
        return False
    lines = skeleton(robot)
    return not capsules or (
        len(capsules) == len(lines)
        and all(
            a.link == b.link and a.radius == b.radius and np.array_equal(a.end, b.end)
            for a, b in zip(capsules, lines, strict=True)
        )
    )


def _list(values: Array) -> str:
    """Return numbers separated by commas; one number if all are equal."""
    return ", ".join(f"{v:.3g}" for v in (values[:1] if np.ptp(values) == 0.0 else values))


def _joints(numbers: list[int], n: int) -> str:
    if len(numbers) == n:
        return "every joint"
    return f"joint{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"
