"""Distances that the links keep: from each other, from walls and from obstacles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics.lie import Motion, Pose
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation.limits import ConstraintSet, SymbolicSet, link_poses
from lieid_casadi.excitation.links import Capsule, capsules_of
from lieid_casadi.excitation.sample_functions import FittedArm, motion_jacobian
from lieid_casadi.robot import Robot

SCALE = 0.2  # m; unit in which violated distances are compared with other violations
TINY = 1e-12  # m²; keeps square roots and quotients of lengths smooth
PROBES = 500  # random poses at which distances are evaluated before the design
OFTEN = 1.0 / 3.0  # part of the probed poses; links two joints apart touching in more are left out
ALWAYS = 0.95  # the same for links that are farther apart
CONSTANT = 1e-9  # m; distances that vary less do not depend on the pose


@dataclass(frozen=True, eq=False)
class _Distance:
    """A distance of a subject in every pose, its Jacobian (1, 3 n), and what to do with it.

    It is left out where it is below the clearance in the fraction ``often`` of random poses.
    ``inside`` is by how much it falls below 0 while the axes of the capsules still are apart.
    """

    subject: str
    label: str
    value: ca.SX
    inside: float
    often: float = np.inf
    slope: ca.SX | None = None


@dataclass(frozen=True)
class SelfCollision:
    """Least distance between the links of the arm, ``clearance`` in m.

    Adjacent links are left out, and pairs for which capsules are too coarse: links two joints
    apart whose capsules touch in a third of random poses or more, and links farther apart that
    touch in nearly all. The result of the design names these pairs. The ``capsules`` of the links
    are by default those of `capsules_of`.
    """

    clearance: float = 0.02
    capsules: tuple[Capsule, ...] = ()

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        motion = Motion.symbols(robot.n)
        poses = link_poses(robot, motion)
        distances = []
        for a, b in combinations(self.capsules or capsules_of(robot), 2):
            if abs(a.link - b.link) <= 1:
                continue
            value, slope = capsule_distance(poses, motion, a, b)
            distances.append(
                _Distance(
                    pair_name(a.link, b.link),
                    f"distance of {link_name(a.link)} from {link_name(b.link)}", value, np.inf,
                    OFTEN if abs(a.link - b.link) == 2 else ALWAYS, slope,
                )
            )  # fmt: skip
        title = f"{self.clearance:g} m between links"
        return _clearance_set("self_collision", title, robot, motion, distances, self.clearance)


def capsule_distance(
    poses: Sequence[Pose], motion: Motion, a: Capsule, b: Capsule
) -> tuple[ca.SX, ca.SX]:
    """Return the distance between the surfaces of two capsules and its Jacobian (1, 3 n).

    The closest points move along their segments to first order without changing the distance, so
    the Jacobian holds them fixed on the segments: it is smooth wherever they are unique.
    """
    starts = [_point_in_base(poses[c.link], c.start) for c in (a, b)]
    edges = [ca.mtimes(poses[c.link].rotation, ca.DM(c.end - c.start)) for c in (a, b)]
    share = [ca.SX.sym("s"), ca.SX.sym("t")]
    gap = starts[0] + share[0] * edges[0] - starts[1] - share[1] * edges[1]
    distance = ca.sqrt(ca.sumsqr(gap) + TINY) - a.radius - b.radius
    jacobian = motion_jacobian(distance, motion)
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
    """Half-space in which the arm must stay: normal·x ≤ offset, base frame, m."""

    normal: tuple[float, float, float]
    offset: float  #: m, for a unit normal
    name: str = "wall"  #: in messages
    capsules: tuple[Capsule, ...] = ()  #: links; by default those of `capsules_of`

    @property
    def plane(self) -> tuple[Array, float]:
        """Unit normal (3,) and offset, m."""
        size = float(np.linalg.norm(self.normal))
        if size == 0.0:
            raise ExcitationError(f"{self.name}: normal 0 0 0; expected a direction")
        return np.array(self.normal) / size, self.offset / size

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        normal, offset = self.plane

        def distances(capsule: Capsule, pose: Pose) -> list[ca.SX]:
            ends = (_point_in_base(pose, point) for point in (capsule.start, capsule.end))
            return [offset - ca.dot(ca.DM(normal), here) - capsule.radius for here in ends]

        title = f"floor at {-offset:g} m" if self.name == "floor" else self.name
        return _distant_from(self, title, robot, distances)


def floor(height: float = 0.0, *, capsules: Sequence[Capsule] = ()) -> Wall:
    """Return the limit that the arm stays above a horizontal floor at a height, m.

    Up is the base's z axis. The links' capsules are by default those of `capsules_of`.
    """
    return Wall((0.0, 0.0, -1.0), -height, "floor", tuple(capsules))


def workspace_box(
    lower: Sequence[float], upper: Sequence[float], *, capsules: Sequence[Capsule] = ()
) -> tuple[Wall, ...]:
    """Return six walls: the arm stays inside the box from ``lower`` to ``upper`` (3,), m.

    The corners are in the base frame; a lower one above an upper one is refused. The links'
    ``capsules`` are by default those of `capsules_of`.
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
    """

    lower: tuple[float, float, float]  #: corner, m
    upper: tuple[float, float, float]
    name: str = "obstacle"  #: in messages
    capsules: tuple[Capsule, ...] = ()  #: links; by default those of `capsules_of`

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        low, high = np.array(self.lower), np.array(self.upper)
        if not np.all(low < high):
            raise ExcitationError(f"{self.name}: a lower corner is not below the upper one")

        def distances(capsule: Capsule, pose: Pose) -> list[ca.SX]:
            balls = covering_balls(capsule)
            return [_outside_box(_point_in_base(pose, x), low, high) - r for x, r in balls]

        return _distant_from(self, self.name, robot, distances)


def covering_balls(capsule: Capsule) -> list[tuple[Array, float]]:
    """Return balls (centre, radius) whose union contains the capsule."""
    length = float(np.linalg.norm(capsule.end - capsule.start))
    pieces = max(1, int(np.ceil(length / max(capsule.radius, 1e-3))))
    radius = float(np.hypot(capsule.radius, 0.5 * length / pieces))
    shares = (np.arange(pieces) + 0.5) / pieces
    balls = [(capsule.start + s * (capsule.end - capsule.start), radius) for s in shares]
    return [*balls, (capsule.start, capsule.radius), (capsule.end, capsule.radius)]


def _outside_box(point: ca.SX, low: Array, high: Array) -> ca.SX:
    """Return the signed distance of a point from a box."""
    beyond = ca.fabs(point - ca.DM(0.5 * (low + high))) - ca.DM(0.5 * (high - low))
    outside = ca.sqrt(ca.sumsqr(ca.fmax(beyond, 0.0)) + TINY)
    return outside + ca.fmin(ca.mmax(beyond), 0.0)


def _point_in_base(pose: Pose, point: Array) -> ca.SX:
    """Return a point (3,) of a link in the base frame, m."""
    return ca.mtimes(pose.rotation, ca.DM(point)) + pose.translation


def link_name(link: int) -> str:
    """Return a link's name in messages."""
    return "the base" if link == 0 else f"link {link}"


def pair_name(a: int, b: int) -> str:
    """Return the name of two links in the lists of what was checked."""
    return " – ".join("base" if link == 0 else f"link {link}" for link in sorted((a, b)))


def _distant_from(
    limit: Wall | Obstacle,
    title: str,
    robot: Robot,
    distances: Callable[[Capsule, Pose], list[ca.SX]],
) -> ConstraintSet:
    """Return the set of a limit that the distances of all moving capsules are not negative."""
    motion, found = Motion.symbols(robot.n), list[_Distance]()
    poses = link_poses(robot, motion)
    for capsule in limit.capsules or capsules_of(robot):
        if capsule.link:
            subject = link_name(capsule.link)
            label = f"distance of {subject} from the {limit.name}"
            values = distances(capsule, poses[capsule.link])
            found += [_Distance(subject, label, value, capsule.radius) for value in values]
    return _clearance_set(limit.name, title, robot, motion, found, 0.0)


def _clearance_set(
    name: str,
    title: str,
    robot: Robot,
    motion: Motion,
    distances: Sequence[_Distance],
    clearance: float,
) -> ConstraintSet:
    """Return the set distance ≥ clearance, with a reason for each distance that is left out."""
    touching, low, high = _probed(robot, motion, distances, clearance)
    kept: list[_Distance] = []
    left_out: dict[str, str] = {}
    for distance, touches, least, most in zip(distances, touching, low, high, strict=True):
        if most - least <= CONSTANT and least >= clearance:
            continue
        if most - least <= CONSTANT and least < clearance - distance.inside - CONSTANT:
            raise NoSolution(
                f"every pose violates a limit: {distance.label} is {least:.3g} m; expected "
                f"{clearance:g} m at least: relax it, or leave it out"
            )
        if most - least <= CONSTANT or touches >= distance.often:
            left_out[distance.subject] = f"its capsules touch in {100.0 * touches:.0f} % of poses"
        else:
            kept.append(distance)
    count = len(kept)
    slopes = [d.slope for d in kept if d.slope is not None]
    return SymbolicSet(
        name, motion, ca.vertcat(ca.SX(0, 1), *(d.value for d in kept)),
        ca.vertcat(*slopes) if slopes else None,
        title=title, labels=tuple(d.label for d in kept), subjects=tuple(d.subject for d in kept),
        units=("m",) * count, lower=np.full(count, clearance), upper=np.full(count, np.inf),
        scale=np.full(count, SCALE), left_out=left_out,
        remedy="another start pose, thinner capsules or a wider workspace",
    )  # fmt: skip


def _probed(
    robot: Robot, motion: Motion, distances: Sequence[_Distance], clearance: float
) -> tuple[Array, Array, Array]:
    """Return the fraction of random poses below the clearance, and the least and most distance."""
    generator = np.random.default_rng(0)
    low, high = robot.limit("position_lower"), robot.limit("position_upper")
    low, high = np.where(np.isfinite(low), low, -np.pi), np.where(np.isfinite(high), high, np.pi)
    q = generator.uniform(low, high, (PROBES, robot.n))
    values = ca.vertcat(ca.SX(0, 1), *(d.value for d in distances))
    function = ca.Function("distances", [motion.q, motion.sin, motion.cos], [values])
    found = function(q.T, np.sin(q).T, np.cos(q).T).full()
    return np.mean(found < clearance, axis=1), found.min(axis=1), found.max(axis=1)
