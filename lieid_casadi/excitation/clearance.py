"""Distances that the links keep: from each other, from walls and from obstacles."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics.lie import Motion as Symbols
from lieid_casadi.dynamics.lie import Pose
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.limits import ConstraintSet, SymbolicSet, UncheckedSet, link_poses
from lieid_casadi.excitation.links import Capsule, skeleton
from lieid_casadi.excitation.sample_functions import FittedArm, motion_jacobian
from lieid_casadi.robot.robot import Robot

logger = logging.getLogger("lieid_casadi")
SCALE = 0.2  # m; unit in which violated distances are compared with other violations
TINY = 1e-12  # m²; keeps square roots and quotients of lengths smooth
PROBES = 500  # random poses at which distances are evaluated before the design


def point_in_base(pose: Pose, point: Array) -> ca.SX:
    """Return a point (3,) of a link in the base frame, m."""
    return ca.mtimes(pose.rotation, ca.DM(point)) + pose.translation


def link_name(robot: Robot, link: int) -> str:
    """Return a link's name in messages."""
    return "the base" if link == 0 else f"link {link}"


def clearances(
    name: str,
    robot: Robot,
    symbols: Symbols,
    labels: list[str],
    distances: list[ca.SX],
    clearance: float,
    slopes: list[ca.SX] | None = None,
    *,
    often: Sequence[float] = (),
) -> ConstraintSet | None:
    """Return the set distance ≥ clearance of the distances that depend on the pose.

    Parameters
    ----------
    name : str
        Of the set, in messages.
    robot : Robot
    symbols : Symbols
    labels : list of str
        Of the distances.
    distances : list of SX (1,)
        m.
    clearance : float
        m.
    slopes : list of SX (1, 3 n), optional
        Jacobians of the distances; differentiated by CasADi if left out.
    often : sequence of float
        Fraction of random poses for each distance: if it is below the clearance in as many or
        more, it is left out, and the set names it.
    """
    if not distances:
        return None
    touching, spread = _probed(robot, symbols, ca.vertcat(*distances), clearance)
    varying = np.flatnonzero((spread > 1e-9) & (touching < (often or np.inf)))
    coarse = [labels[k] for k in np.flatnonzero((spread > 1e-9) & (touching >= (often or np.inf)))]
    if coarse:
        logger.info(
            "%s: not checked, because the capsules are too coarse: %s", name, "; ".join(coarse)
        )
    if not len(varying):
        return UncheckedSet(coarse) if coarse else None
    count = len(varying)
    chosen = ca.vertcat(*(distances[k] for k in varying))
    jacobian = None if slopes is None else ca.vertcat(*(slopes[k] for k in varying))
    return SymbolicSet(
        "".join(c if c.isalnum() else "_" for c in name), symbols, chosen, jacobian,
        labels=[labels[k] for k in varying], units=["m"] * count,
        lower=np.full(count, clearance), upper=np.full(count, np.inf), scale=np.full(count, SCALE),
        remedy="another start pose, thinner capsules or a wider workspace", left_out=coarse,
    )  # fmt: skip


def _probed(
    robot: Robot, symbols: Symbols, distances: ca.SX, clearance: float
) -> tuple[Array, Array]:
    """Return the fraction of random poses below the clearance, and the range of each distance."""
    generator = np.random.default_rng(0)
    low, high = robot.limit("position_lower"), robot.limit("position_upper")
    low, high = np.where(np.isfinite(low), low, -np.pi), np.where(np.isfinite(high), high, np.pi)
    q = generator.uniform(low, high, (PROBES, robot.n))
    function = ca.Function("distances", [symbols.q, symbols.sin, symbols.cos], [distances])
    values = function(q.T, np.sin(q).T, np.cos(q).T).full()
    return np.mean(values < clearance, axis=1), np.ptp(values, axis=1)


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
