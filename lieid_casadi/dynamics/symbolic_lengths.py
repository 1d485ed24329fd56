"""Symbols in place of the lengths of a robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from lieid_casadi.dynamics.null_space import RANK_TOLERANCE
from lieid_casadi.robot import Robot
from lieid_casadi.robot.geometry import Geometry, relative


@dataclass(frozen=True, eq=False)
class SymbolicLengths:
    """A robot with symbols for its lengths.

    Attributes
    ----------
    robot : Robot
        Its translations between link frames are symbols.
    values : dict
        Name of each symbol → the robot's own length, m.
    places : dict
        Name of each symbol → what it is the length of.
    """

    robot: Robot
    values: dict[str, float]
    places: dict[str, str]


def symbolic_lengths(robot: Robot) -> SymbolicLengths:
    """Return the robot with a symbol for each length that is not zero.

    ``d3`` is the one coordinate of link 3's frame in that of link 2 that is not zero; of several
    they are ``d3x``, ``d3y``, ``d3z``. Lengths of the same size have symbols of their own. Angles,
    and the place of an axis that does not pass through its link frame's origin, stay numbers.
    """
    values: dict[str, float] = {}
    places: dict[str, str] = {}
    before: Geometry = np.eye(4)
    here: Geometry = np.eye(4).astype(object)
    joints = []
    for i, joint in enumerate(robot.joints, start=1):
        step = relative(before, joint.home).astype(object)
        parent = f"link {i - 1}" if i > 1 else "the base"
        long = [k for k in range(3) if abs(step[k, 3]) > RANK_TOLERANCE]
        for k in range(3):
            length, name = step[k, 3], f"d{i}{'xyz'[k] if len(long) > 1 else ''}"
            step[k, 3] = ca.SX.sym(name) if k in long else 0.0
            if k in long:
                values[name] = length
                places[name] = f"{'xyz'[k]} of the frame of link {i} in that of {parent}"
        here, before = here @ step, joint.home
        omega, v = joint.axis[:3], joint.axis[3:]
        rotation, origin = here[:3, :3], here[:3, 3]
        turned = rotation @ omega
        screw = np.concatenate([turned, rotation @ v + np.cross(origin, turned)])
        joints.append(replace(joint, screw=screw, home=here))
    return SymbolicLengths(replace(robot, joints=tuple(joints), source=None), values, places)
