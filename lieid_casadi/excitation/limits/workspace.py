"""Workspace limits: floor, walls and boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics.lie import Motion as Symbols
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.fitted_arm import FittedArm
from lieid_casadi.excitation.limits.capsules import Capsule, skeleton
from lieid_casadi.excitation.limits.constraint_sets import ConstraintSet
from lieid_casadi.excitation.limits.link_clearances import (
    TINY,
    clearances,
    link_name,
    point_in_base,
)
from lieid_casadi.excitation.limits.symbolic_limits import link_poses
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Wall:
    """Half-space in which the arm must stay: normal·x ≤ offset, base frame, m.

    Attributes
    ----------
    normal : (3,)
    offset : float
        m, for a unit normal.
    name : str
        In messages.
    capsules : tuple of Capsule
        Links. Default: along the lines from joint to joint.
    """

    normal: tuple[float, float, float]
    offset: float
    name: str = "wall"
    capsules: tuple[Capsule, ...] = ()

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        size = float(np.linalg.norm(self.normal))
        if size == 0.0:
            raise ExcitationError(f"{self.name}: normal 0 0 0; expected a direction")
        normal, offset = np.array(self.normal) / size, self.offset / size
        symbols = Symbols.symbols(robot.n)
        poses = link_poses(robot, symbols)
        labels, distances = [], []
        for capsule in self.capsules or skeleton(robot):
            for point in (capsule.start, capsule.end):
                here = point_in_base(poses[capsule.link], point)
                distances.append(offset - ca.dot(ca.DM(normal), here) - capsule.radius)
                labels.append(f"distance of {link_name(robot, capsule.link)} from the {self.name}")
        return clearances(self.name, robot, symbols, labels, distances, 0.0)


def floor(height: float = 0.0, *, capsules: Sequence[Capsule] = ()) -> Wall:
    """Return the limit that the arm stays above a horizontal floor.

    Parameters
    ----------
    height : float
        Of the floor in the base frame, m; up is the base's z axis.
    capsules : sequence of Capsule
        Links. Default: along the lines from joint to joint.
    """
    return Wall((0.0, 0.0, -1.0), -height, "floor", tuple(capsules))


def workspace_box(
    lower: Sequence[float], upper: Sequence[float], *, capsules: Sequence[Capsule] = ()
) -> tuple[Wall, ...]:
    """Return six walls: the arm stays inside the box from ``lower`` to ``upper``.

    Parameters
    ----------
    lower, upper : (3,)
        Corners in the base frame, m.
    capsules : sequence of Capsule
        Links. Default: along the lines from joint to joint.

    Raises
    ------
    ExcitationError
        A lower corner above an upper one.
    """
    walls = []
    for axis, (low, high) in enumerate(zip(lower, upper, strict=True)):
        if not low < high:
            raise ExcitationError(
                f"workspace box: lower {low:g} m, upper {high:g} m along {'xyz'[axis]}"
            )
        unit = [0.0, 0.0, 0.0]
        for sign, edge in ((-1.0, low), (1.0, high)):
            unit[axis] = sign
            side = f"wall at {'xyz'[axis]} = {edge:g} m"
            walls.append(Wall(tuple(unit), sign * edge, side, tuple(capsules)))  # type: ignore[arg-type]
    return tuple(walls)


@dataclass(frozen=True)
class Obstacle:
    """Box along the axes of the base that the arm must avoid.

    Each capsule is replaced by balls that contain it (`covering_balls`).

    Attributes
    ----------
    lower, upper : (3,)
        Corners, m.
    name : str
        In messages.
    capsules : tuple of Capsule
        Links. Default: along the lines from joint to joint.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    name: str = "obstacle"
    capsules: tuple[Capsule, ...] = ()

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        low, high = np.array(self.lower), np.array(self.upper)
        if not np.all(low < high):
            raise ExcitationError(f"{self.name}: a lower corner is not below the upper one")
        symbols = Symbols.symbols(robot.n)
        poses = link_poses(robot, symbols)
        labels, distances = [], []
        for capsule in self.capsules or skeleton(robot):
            for point, radius in covering_balls(capsule):
                here = point_in_base(poses[capsule.link], point)
                distances.append(_outside_box(here, low, high) - radius)
                labels.append(f"distance of {link_name(robot, capsule.link)} from the {self.name}")
        return clearances(self.name, robot, symbols, labels, distances, 0.0)


def covering_balls(capsule: Capsule) -> list[tuple[Array, float]]:
    """Return balls (centre, radius) whose union contains the capsule."""
    length = float(np.linalg.norm(capsule.end - capsule.start))
    pieces = max(1, int(np.ceil(length / max(capsule.radius, 1e-3))))
    radius = float(np.hypot(capsule.radius, 0.5 * length / pieces))
    shares = (np.arange(pieces) + 0.5) / pieces
    balls = [(capsule.start + s * (capsule.end - capsule.start), radius) for s in shares]
    ends = [(capsule.start, capsule.radius), (capsule.end, capsule.radius)]
    return balls + ends


def _outside_box(point: ca.SX, low: Array, high: Array) -> ca.SX:
    """Return the signed distance of a point from a box."""
    beyond = ca.fabs(point - ca.DM(0.5 * (low + high))) - ca.DM(0.5 * (high - low))
    outside = ca.sqrt(ca.sumsqr(ca.fmax(beyond, 0.0)) + TINY)
    return outside + ca.fmin(ca.mmax(beyond), 0.0)
