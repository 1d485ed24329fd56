"""What a motion is checked against: the default limits, and the verification of a finished motion.

The verification shares nothing with the search but the limits: positions, speeds and torques are
Pinocchio's, distances are coal's between the shapes of the links, at 1 kHz. What it covered is
``checked``, everything else ``unchecked``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation.clearance import Obstacle, SelfCollision, Wall, floor, link_name
from lieid_casadi.excitation.clearance import pair_name as pair
from lieid_casadi.excitation.limits import (
    CartesianSpeed,
    ConstraintSet,
    Limit,
    LimitOnArm,
    MotionRange,
    Torque,
    joint_names,
    numbers,
    speed_points,
    torque_limits,
)
from lieid_casadi.excitation.links import Capsule, Shape, capsules_of, collision_shapes
from lieid_casadi.excitation.rigid_arm import (
    ArmAlong,
    box_shape,
    capsule_shape,
    nearness_to_singular,
)
from lieid_casadi.excitation.sample_functions import FittedArm
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.robot import Robot

MARGIN = 0.8  # part of the velocity and torque limits that a design uses
TOOL_SPEED = 1.5  # m/s
FLOOR = 0.0  # m, base frame
CLEARANCE = 0.02  # m, between links
CONTROL_STEP = 1e-3  # s; of the verification
SINGULAR = 0.1  # σ_min of the tool's Jacobian at rest, in parts of its typical value, at least
ROUNDING = 1e-6  # of a joint's limit, or m/s: differences between two ways of computing
ROUNDING_LENGTH = 1e-5  # m; the same for distances


def default_limits(
    robot: Robot,
    *,
    margin: float = MARGIN,
    floor_height: float | None = FLOOR,
    cartesian_speed: float | None = TOOL_SPEED,
    clearance: float | None = CLEARANCE,
    capsules: Sequence[Capsule] | None = None,
) -> tuple[Limit, ...]:
    """Return `Torque`, `CartesianSpeed`, `floor` and `SelfCollision`, as far as they apply.

    They are the limits of a robot besides those of the joints; None leaves a limit out.

    Parameters
    ----------
    margin : float
        Part of the torque limits, where the robot states inertias and torque limits.
    floor_height, cartesian_speed, clearance : float or None
        Height of the floor in the base frame, m; speed of the tool and the joint centres, m/s;
        distance between links, m.
    capsules : sequence of Capsule, optional
        Links. Default: those of `capsules_of`.
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


def control_times(duration: float) -> Array:
    """Return times (N,) at 1 kHz, with the end, s."""
    return np.append(np.arange(0.0, duration, CONTROL_STEP), duration)


@dataclass(frozen=True, eq=False)
class Verification:
    """Limits that a motion was verified to keep, and limits that it was not, in words."""

    checked: tuple[str, ...]
    unchecked: tuple[str, ...]


def verify(
    robot: Robot,
    motion: MotionSamples,
    joints: MotionRange,
    limits: Sequence[LimitOnArm],
    fit: FittedArm | None,
) -> Verification:
    """Verify a motion at its samples, and return what was checked and what was not."""
    along = ArmAlong(robot, motion)
    findings = [*_joint_findings(joints, motion)]
    findings += [_finding(limit, along, fit) for limit in limits]
    for finding in findings:
        finding.refuse_violations()
    checked, unchecked = [finding.checked for finding in findings], list[str]()
    nearness = float(nearness_to_singular(robot, motion.q[:1])[0])
    rest = f"rest pose: σ_min of the tool's Jacobian is {nearness:.2g} of its typical value"
    (checked if nearness >= SINGULAR else unchecked).append(rest)
    unchecked += [
        *(text for finding in findings for text in finding.unchecked),
        *_kinds_without_limit(robot, [x.limit for x in limits]),
        *_general_remarks(robot, [x.limit for x in limits], fit),
    ]
    return Verification(tuple(text for text in checked if text), tuple(dict.fromkeys(unchecked)))


@dataclass(eq=False)
class _Finding:
    """Excess (negative inside) of every subject of a limit that was evaluated.

    ``excused`` has subjects that the search did not restrict, with the reason: they are unchecked
    where they violate the limit, or were not evaluated. ``lines`` are those of unknown shape.
    """

    title: str
    name: str
    unit: str = ""
    tolerance: float = ROUNDING_LENGTH
    excess: dict[str, float] = field(default_factory=dict)
    times: dict[str, float] = field(default_factory=dict)
    excused: dict[str, str] = field(default_factory=dict)
    lines: set[str] = field(default_factory=set)
    itemized: bool = True

    def add(self, subject: str, excess: float, time: float) -> None:
        """Record an excess; the largest of a subject counts."""
        if excess > self.excess.get(subject, -np.inf):
            self.excess[subject], self.times[subject] = excess, time

    def add_along(self, subject: str, excess: Array, t: Array) -> None:
        """Record the largest excess (N,) along a motion at times t (N,)."""
        k = int(np.argmax(excess))
        self.add(subject, float(excess[k]), float(t[k]))

    def refuse_violations(self) -> None:
        """Raise `NoSolution` for a subject beyond its limit that is not excused."""
        for subject, excess in self.excess.items():
            if excess > self.tolerance and subject not in self.excused:
                raise NoSolution(
                    f"the verification of the motion failed: {self.title}, {subject}: beyond it by "
                    f"{excess:.3g} {self.unit} at {self.times[subject]:.3g} s; relax this limit, "
                    "or choose another start pose or seed"
                )

    @property
    def kept(self) -> list[str]:
        """Subjects that were found within the limit."""
        return [name for name, excess in self.excess.items() if excess <= self.tolerance]

    @property
    def checked(self) -> str:
        """The limit and its subjects; empty if there is none."""
        if not self.itemized:
            return self.title if len(self.kept) == len(self.excess) else ""
        names = [f"{name} (line)" if name in self.lines else name for name in self.kept]
        return f"{self.title}: {', '.join(names)}" if names else ""

    @property
    def unchecked(self) -> list[str]:
        """The subjects that are not in `checked`, by reason."""
        others: dict[str, list[str]] = {}
        for subject, reason in self.excused.items():
            if self.excess.get(subject, np.inf) > self.tolerance:
                others.setdefault(reason, []).append(subject)
        return [f"{self.name}: {', '.join(names)} ({why})" for why, names in others.items()]


def _joint_findings(joints: MotionRange, motion: MotionSamples) -> Iterator[_Finding]:
    names, low, high = joint_names(range(len(joints.velocity))), *joints.position.T
    unit = "rad" if joints.revolute.all() else "rad or m"
    for title, name, values, bounds, suffix in (
        ("position", "lower position limit", -motion.q, -low, ""),
        ("position", "upper position limit", motion.q, high, ""),
        (f"velocity ({numbers(joints.velocity)} {unit}/s)", "velocity",
         np.abs(motion.dq), joints.velocity, "/s"),
        (f"acceleration ({numbers(joints.acceleration)} {unit}/s²)", "acceleration",
         np.abs(motion.ddq), joints.acceleration, "/s²"),
    ):  # fmt: skip
        finding = _Finding(title if title != "position" else name, name, unit + suffix)
        stated = np.abs(bounds[np.isfinite(bounds)])
        finding.tolerance = ROUNDING * float(stated.max(initial=1.0))
        for j, subject in enumerate(names):
            if np.isfinite(bounds[j]):
                finding.add_along(subject, values[:, j] - bounds[j], motion.t)
            else:
                finding.excused[subject] = "no limit is stated"
        yield finding


def _finding(limit: LimitOnArm, along: ArmAlong, fit: FittedArm | None) -> _Finding:
    made, own = limit.set, limit.limit
    name = str(getattr(own, "name", type(own).__name__))
    finding = _Finding(getattr(made, "title", "") or name, name)
    finding.excused = dict(made.left_out) if made is not None else {}
    if isinstance(own, CartesianSpeed):
        finding.name, finding.unit, finding.tolerance = "tool speed", "m/s", ROUNDING
        points = speed_points(along.robot)
        speeds = along.speeds([(link, point) for _, link, point in points], own.limit)
        for (subject, _, _), row in zip(points, speeds.T, strict=True):
            finding.add_along(subject, row - own.limit, along.motion.t)
    elif isinstance(own, Torque) and fit is None:
        finding.name, finding.unit = "torque", "N·m"
        _rigid_torque(finding, own, along)
    elif isinstance(own, Wall | Obstacle | SelfCollision):
        finding.unit = "m"
        _distances(finding, own, along)
    elif made is not None:
        finding.name = "torque" if isinstance(own, Torque) else name
        _by_its_own_set(finding, made, along.motion)
    return finding


def _by_its_own_set(finding: _Finding, made: ConstraintSet, motion: MotionSamples) -> None:
    """Evaluate a limit of the user's, or the torque of a fit: only its own functions know it."""
    finding.itemized = bool(made.subjects)
    finding.tolerance = ROUNDING * float(made.scale.max(initial=0.0))
    subjects = made.subjects or made.labels
    for subject, excess, time in zip(subjects, *made.largest_excess(motion), strict=True):
        finding.add(subject, float(excess), float(time))


def _rigid_torque(finding: _Finding, limit: Torque, along: ArmAlong) -> None:
    torque, velocity = torque_limits(along.robot), along.robot.limit("velocity")
    finding.tolerance = ROUNDING * float(np.nanmax(torque))
    rigid = along.torque()
    loaded = rigid + limit.viscous * torque / velocity * along.motion.dq
    excess = np.maximum(np.abs(rigid), np.abs(loaded)) - (limit.fraction - limit.dry) * torque
    for j, subject in enumerate(joint_names(range(along.robot.n))):
        if np.isfinite(torque[j]):
            finding.add_along(subject, excess[:, j], along.motion.t)


def _distances(finding: _Finding, limit: Wall | Obstacle | SelfCollision, along: ArmAlong) -> None:
    """Evaluate the distances of the links' shapes; links without one are excused."""
    capsules, n = tuple(limit.capsules) or capsules_of(along.robot), along.robot.n
    bodies = _bodies(along.robot, capsules)
    lines = {capsule.link for capsule in capsules if capsule.source == "line"}
    if isinstance(limit, SelfCollision):
        finding.name = "self-collision"
        for a, b in combinations(range(n + 1), 2):
            if b - a == 1:
                finding.excused[pair(a, b)] = "adjacent"
            elif not (bodies[a] and bodies[b]):
                finding.excused[pair(a, b)] = "no shape"
            else:
                near = bodies[a], bodies[b], limit.clearance, finding.tolerance
                finding.add(pair(a, b), *along.nearest(*near))
            finding.lines.update({pair(a, b)} if lines & {a, b} else ())
        return
    finding.excused[link_name(0)] = "does not move"
    finding.lines.update(map(link_name, lines))
    for link in range(1, n + 1):
        if not bodies[link]:
            finding.excused[link_name(link)] = "no shape"
        elif isinstance(limit, Wall):
            for body in bodies[link]:
                beyond = along.beyond_plane(body, *limit.plane, finding.tolerance)
                finding.add(link_name(link), *beyond)
        else:
            box = box_shape(np.array(limit.lower), np.array(limit.upper))
            nearest = along.nearest(bodies[link], [box], 0.0, finding.tolerance)
            finding.add(link_name(link), *nearest)


def _bodies(robot: Robot, capsules: Sequence[Capsule]) -> list[list[Shape]]:
    """Return the shapes of every link, the base first: collision geometry, or given capsules."""
    bodies: list[list[Shape]] = [[] for _ in range(robot.n + 1)]
    enclosed = {c.link for c in capsules if c.source == "shape"}
    if enclosed:
        for shape in collision_shapes(robot)[0]:
            if shape.link in enclosed:
                bodies[shape.link].append(shape)
    for capsule in capsules:
        if capsule.source != "shape":
            bodies[capsule.link].append(capsule_shape(capsule))
    return bodies


def _kinds_without_limit(robot: Robot, limits: Sequence[Limit]) -> Iterator[str]:
    """Yield the usual limits that are not among those of a design."""
    if not any(isinstance(limit, Torque) for limit in limits):
        yield "torque of every joint"
    yield "jerk"
    if not any(isinstance(limit, CartesianSpeed) for limit in limits):
        yield "tool speed"
    if not any(isinstance(limit, Wall) and limit.normal[2] < 0.0 for limit in limits):
        yield "floor"
    if not any(isinstance(limit, SelfCollision) for limit in limits):
        yield "self-collision"


def _general_remarks(robot: Robot, limits: Sequence[Limit], fit: FittedArm | None) -> Iterator[str]:
    """Yield what no limit of a design covers."""
    if any(isinstance(limit, Torque) for limit in limits):
        yield (
            "torque of payloads and inertias other than the stated ones, and of friction above "
            "the allowance"
            if fit is None
            else "torque of payloads and temperatures other than in the recordings of the fit"
        )
    near = [x for x in limits if isinstance(x, Wall | Obstacle | SelfCollision)]
    used = [c for limit in near for c in (limit.capsules or capsules_of(robot))]
    lines = dict.fromkeys(link_name(c.link) for c in used if c.source == "line")
    if lines:
        yield (
            f"shapes: {', '.join(lines)} (no collision geometry was found: a capsule along the "
            "line between joints was checked; state capsules with --capsules)"
        )
    unknown = collision_shapes(robot)[1] if any(c.source != "given" for c in used) else ()
    if unknown:
        yield f"shapes: {', '.join(unknown)} (no collision geometry, or a mesh was not found)"
    yield "surroundings other than the stated ones"
