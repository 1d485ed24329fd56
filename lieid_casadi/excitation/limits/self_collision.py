"""Self-collision: distances between the capsules of the links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics.lie import Motion as Symbols
from lieid_casadi.dynamics.lie import Pose
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
from lieid_casadi.excitation.sample_functions import motion_jacobian
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]
OFTEN = 1.0 / 3.0  # part of the probed poses; links two joints apart touching in more are left out
ALWAYS = 0.95  # the same for links that are farther apart


@dataclass(frozen=True)
class SelfCollision:
    """Least distance between the links of the arm.

    Adjacent links are left out, and pairs for which capsules are too coarse: links two joints
    apart whose capsules touch in a third of random poses or more, and links farther apart that
    touch in nearly all. The result of the design and the log name these pairs.

    Attributes
    ----------
    clearance : float
        m.
    capsules : tuple of Capsule
        Links. Default: along the lines from joint to joint (`skeleton`).
    """

    clearance: float = 0.02
    capsules: tuple[Capsule, ...] = ()

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        symbols = Symbols.symbols(robot.n)
        poses = link_poses(robot, symbols)
        labels, distances, slopes, often = [], [], [], []
        for a, b in combinations(self.capsules or skeleton(robot), 2):
            if abs(a.link - b.link) <= 1:
                continue
            often.append(OFTEN if abs(a.link - b.link) == 2 else ALWAYS)
            distance, jacobian = capsule_distance(poses, symbols, a, b)
            labels.append(f"distance of {link_name(robot, a.link)} from {link_name(robot, b.link)}")
            distances.append(distance)
            slopes.append(jacobian)
        return clearances(
            "self_collision", robot, symbols, labels, distances, self.clearance, slopes, often=often
        )


def capsule_distance(
    poses: Sequence[Pose], symbols: Symbols, a: Capsule, b: Capsule
) -> tuple[ca.SX, ca.SX]:
    """Return the distance between the surfaces of two capsules and its Jacobian (1, 3 n).

    Parameters
    ----------
    poses : sequence of Pose
        Of the base and of every link, in the base frame.
    symbols : Symbols
    a, b : Capsule

    Notes
    -----
    The closest points move along their segments to first order without changing the distance, so
    the Jacobian holds them fixed on the segments: it is smooth wherever they are unique.
    """
    starts = [point_in_base(poses[c.link], c.start) for c in (a, b)]
    edges = [ca.mtimes(poses[c.link].rotation, ca.DM(c.end - c.start)) for c in (a, b)]
    share = [ca.SX.sym("s"), ca.SX.sym("t")]
    gap = starts[0] + share[0] * edges[0] - starts[1] - share[1] * edges[1]
    distance = ca.sqrt(ca.sumsqr(gap) + TINY) - a.radius - b.radius
    jacobian = motion_jacobian(distance, symbols)
    closest = ca.vertcat(*_closest(starts, edges, a, b))
    here = ca.vertcat(*share)
    return ca.substitute(distance, here, closest), ca.substitute(jacobian, here, closest)


def _closest(
    starts: list[ca.SX], edges: list[ca.SX], a: Capsule, b: Capsule
) -> tuple[ca.SX, ca.SX]:
    """Return the positions (0 to 1) of the closest points on both segments (Ericson, 5.1.9)."""
    between = starts[0] - starts[1]
    length_a = float(np.sum((a.end - a.start) ** 2)) + TINY
    length_b = float(np.sum((b.end - b.start) ** 2)) + TINY
    along = ca.dot(edges[0], edges[1])
    on_a, on_b = ca.dot(edges[0], between), ca.dot(edges[1], between)
    s = _unit((along * on_b - on_a * length_b) / (length_a * length_b - along**2 + TINY))
    t = _unit((along * s + on_b) / length_b)
    # a second pass makes it exact after clamping and for parallel segments
    s = _unit((along * t - on_a) / length_a)
    t = _unit((along * s + on_b) / length_b)
    s = _unit((along * t - on_a) / length_a)
    return s, t


def _unit(value: ca.SX) -> ca.SX:
    return ca.fmin(1.0, ca.fmax(0.0, value))
