"""Limits on a motion: of joints, of expressions of its symbols, and of the tool's speed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.lie import Motion, Pose, constant, cross
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.links import fixed_frames
from lieid_casadi.excitation.sample_functions import FittedArm, SampleKernel, motion_jacobian
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.robot import Robot

ACCELERATION = 3.0  # rad/s² (m/s²) where the robot states none
LEAST_MOTION = 0.05  # rad; shorter durations are refused
CHUNK = 4000  # samples that are evaluated at a time
SMOOTHING = 1e-4  # m/s; √(v² + SMOOTHING²) has a gradient at rest


class ConstraintSet(ABC):
    """Quantities of a motion sample that must stay between limits."""

    title: str = ""  # of the limit, in the lists of what was checked
    labels: tuple[str, ...]  # name of each quantity in messages
    subjects: tuple[str, ...] = ()  # link, pair or joint of each; several may belong to one
    units: tuple[str, ...]
    lower: Array  # (k,): infinite where there is no limit
    upper: Array  # (k,)
    scale: Array  # (k,): unit in which violations of different quantities are compared
    remedy: str  # what to relax, for messages
    linear: bool = False  # in q, dq and ddq
    left_out: Mapping[str, str] = {}  # subject → why it is not checked

    @abstractmethod
    def values(self, motion: MotionSamples) -> Array:
        """Return the quantities (k, N)."""

    @abstractmethod
    def jacobian(self, motion: MotionSamples) -> Array:
        """Return ∂values/∂(q, dq, ddq) (k, 3 n, N)."""

    def excess(self, values: Array) -> Array:
        """Return by how much values (k, N) exceed the limits, in their units; negative inside."""
        return np.maximum(values - self.upper[:, None], self.lower[:, None] - values)

    def largest_excess(self, motion: MotionSamples) -> tuple[Array, Array]:
        """Return the largest excess of every quantity along a motion (k,), and when (k,), s."""
        worst, when = np.full(len(self.labels), -np.inf), np.zeros(len(self.labels))
        for first in range(0, len(motion), CHUNK):
            part = motion.at(slice(first, first + CHUNK))
            excess = self.excess(self.values(part))
            k = np.argmax(excess, axis=1)
            here = excess[np.arange(len(k)), k]
            when, worst = np.where(here > worst, part.t[k], when), np.maximum(here, worst)
        return worst, when


class Limit(Protocol):
    """A limit that a caller specifies; for a robot it becomes a constraint set."""

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """Return the set for a robot; None if no motion of the robot can violate the limit.

        A fit has the identified parameters, for limits that depend on the torque. An
        `ExcitationError` says what the robot lacks.
        """


@dataclass(frozen=True, eq=False)
class LimitOnArm:
    """A limit, and the set that it is for a robot; None if no motion can violate it."""

    limit: Limit
    set: ConstraintSet | None


def on_arm(limits: Sequence[Limit], robot: Robot, fit: FittedArm | None) -> tuple[LimitOnArm, ...]:
    """Return limits with their sets for a robot, or for a fit."""
    for limit in limits:
        if not hasattr(limit, "on"):
            raise ExcitationError(f"limits: {limit!r:.60}; expected limits, such as Torque()")
    return tuple(LimitOnArm(limit, limit.on(robot, fit)) for limit in limits)


def sets_of(limits: Sequence[LimitOnArm]) -> tuple[ConstraintSet, ...]:
    """Return the sets that restrict a motion."""
    return tuple(x.set for x in limits if x.set is not None and len(x.set.labels))


@dataclass(frozen=True, eq=False)
class MotionRange:
    """Limits of every joint: position (n, 2), velocity and acceleration (n,).

    rad, rad/s, rad/s² (m for prismatic joints). Positions are infinite without end stops.
    """

    position: Array
    velocity: Array
    acceleration: Array
    revolute: Mask

    @property
    def _stops(self) -> Mask:
        """Whether each joint has end stops (n, 1)."""
        return np.asarray(np.isfinite(self.position).all(axis=1, keepdims=True))

    @property
    def middle(self) -> Array:
        """Middle of the joint ranges (n,), zero without end stops."""
        return np.asarray(np.where(self._stops, self.position, 0.0).mean(axis=1))

    @property
    def units(self) -> Array:
        """Half range, velocity and acceleration limit (n, 3), as units of the free variables."""
        half = np.where(self._stops, self.position, [-np.pi, np.pi])
        return np.stack([0.5 * np.ptp(half, axis=1), self.velocity, self.acceleration], axis=1)


class JointLimits(ConstraintSet):
    """Position, velocity and acceleration of each joint."""

    linear = True
    remedy = "a longer duration, fewer harmonics or wider joint limits"

    def __init__(self, joints: MotionRange) -> None:
        velocity, acceleration, n = joints.velocity, joints.acceleration, len(joints.velocity)
        self.lower = np.concatenate([joints.position[:, 0], -velocity, -acceleration])
        self.upper = np.concatenate([joints.position[:, 1], velocity, acceleration])
        half = 0.5 * np.diff(joints.position, axis=1)[:, 0]
        self.scale = np.concatenate(
            [np.where(np.isfinite(half), half, np.pi), velocity, acceleration]
        )
        kinds = ("position", "velocity", "acceleration")
        self.labels = tuple(f"{kind} of joint {j + 1}" for kind in kinds for j in range(n))
        self.units = tuple(
            ("rad" if turn else "m") + suffix
            for suffix in ("", "/s", "/s²")
            for turn in joints.revolute
        )
        self._n = n

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return np.concatenate([motion.q.T, motion.dq.T, motion.ddq.T])

    def jacobian(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        identity = np.eye(3 * self._n)[:, :, None]
        return np.broadcast_to(identity, (3 * self._n, 3 * self._n, len(motion)))


def motion_range(
    robot: Robot, acceleration: ArrayLike | None = None, *, margin: float = 1.0
) -> MotionRange:
    """Return the limits of a robot, with ``margin`` of its velocity limits.

    An acceleration, one number or (n,) in rad/s², replaces the robot's own; where neither is stated
    it is 3.
    """
    position = np.stack([robot.limit("position_lower"), robot.limit("position_upper")], axis=1)
    position = np.where(np.isnan(position), [-np.inf, np.inf], position)
    for j, (low, high) in enumerate(position):
        if not low < high:
            raise ExcitationError(
                f"robot {robot.name!r}: position limits of {joint_name(robot, j)} contradict each "
                f"other: lower {low:g}, upper {high:g}"
            )
    if not 0.0 < margin <= 1.0:
        raise ExcitationError(f"margin: {margin:g}; expected more than 0, at most 1")
    velocity = margin * robot.limit("velocity")
    missing = [joint_name(robot, j) for j in range(robot.n) if not velocity[j] > 0.0]
    if missing:
        raise ExcitationError(
            f"robot {robot.name!r} states no velocity limit for {', '.join(missing)}; "
            "add it to the robot's description, or state it (--velocity V…)"
        )
    revolute = np.array([joint.revolute for joint in robot.joints])
    return MotionRange(position, velocity, _acceleration(robot, acceleration), revolute)


def check_duration(robot: Robot, limits: MotionRange, duration: float) -> None:
    """Refuse a period (s) in which the limits allow less than 0.05 rad of motion."""
    rate = 2.0 * np.pi / duration
    for name, limit, power in (
        ("velocity", limits.velocity, 1),
        ("acceleration", limits.acceleration, 2),
    ):
        reach = limit / rate**power
        j = int(np.argmin(reach))
        if reach[j] < LEAST_MOTION:
            enough = 2.0 * np.pi * (LEAST_MOTION / limit[j]) ** (1.0 / power)
            raise ExcitationError(
                f"duration: {duration:g} s is too short for the {name} limit of "
                f"{joint_name(robot, j)}, {limit[j]:g}: its amplitude would be {reach[j]:.2g} rad; "
                f"expected {enough:.2g} s at least"
            )


def _acceleration(robot: Robot, given: ArrayLike | None) -> Array:
    if given is None:
        stated = robot.limit("acceleration")
        return np.where(np.isfinite(stated), stated, ACCELERATION)
    values = np.atleast_1d(np.asarray(given, dtype=float))
    if values.size not in (1, robot.n):
        raise ExcitationError(
            f"acceleration: {values.size} numbers; expected 1 or {robot.n}, one per joint"
        )
    if not np.all(np.isfinite(values) & (values > 0.0)):
        raise ExcitationError("acceleration: expected positive numbers")
    return np.broadcast_to(values, robot.n).copy()


def joint_name(robot: Robot, j: int) -> str:
    """Return a joint in messages, from 1."""
    return f"joint {j + 1} ({robot.joints[j].name})"


class SymbolicSet(ConstraintSet):
    """Quantities (k,) given as CasADi expressions of a motion's symbols."""

    def __init__(
        self,
        name: str,
        motion: Motion,
        quantities: ca.SX,
        jacobian: ca.SX | None = None,
        **facts: object,
    ) -> None:
        vars(self).update(facts)
        if not quantities.numel():
            return
        slopes = motion_jacobian(quantities, motion) if jacobian is None else jacobian
        name = "".join(c if c.isalnum() and c.isascii() else "_" for c in name)
        self._values = SampleKernel(name, motion, ca.densify(quantities))
        self._slopes = SampleKernel(f"{name}_jacobian", motion, slopes)

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return self._values.dense(motion)[:, 0]  # identically zero quantities included

    def jacobian(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return self._slopes.dense(motion)


@dataclass(frozen=True)
class CartesianSpeed:
    """Limited speed of the tool, of every joint's centre and of the URDF's further frames."""

    limit: float  #: m/s, above 0

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        if not self.limit > 0.0:
            raise ExcitationError(f"Cartesian speed: {self.limit:g}; expected a positive number")
        motion = Motion.symbols(robot.n)
        twists = closed_form.link_velocities(robot, motion)
        subjects, speeds = [], []
        for subject, link, point in speed_points(robot):
            twist = twists[link - 1]
            squared = ca.sumsqr(twist[3:] + cross(twist[:3], constant(point)))
            if ca.depends_on(squared, motion.dq):
                subjects.append(subject)
                speeds.append(ca.sqrt(squared + SMOOTHING**2))
        return SymbolicSet(
            "speed", motion, ca.vertcat(*speeds), title=f"speed up to {self.limit:g} m/s",
            labels=tuple(f"speed of the {subject}" for subject in subjects),
            subjects=tuple(subjects), units=("m/s",) * len(subjects),
            lower=np.full(len(subjects), -np.inf), upper=np.full(len(subjects), self.limit),
            scale=np.full(len(subjects), self.limit),
            remedy="a longer duration or a higher Cartesian speed",
        )  # fmt: skip


def speed_points(robot: Robot) -> list[tuple[str, int, Array]]:
    """Return name, link (from 1) and position (3,) of the points whose speed is limited."""
    points = [(f"centre of joint {i}", i, np.zeros(3)) for i in range(1, robot.n + 1)]
    points.append(("tool", robot.n, robot.tool[:3, 3]))
    for name, link, point in fixed_frames(robot):
        known = [place for _, other, place in points if other == link]
        if all(np.linalg.norm(point - place) > 1e-6 for place in known):
            points.append((f"frame {name}", link, point))
    return points


def link_poses(robot: Robot, motion: Motion) -> list[Pose]:
    """Return the frames of the base and of every link, in the base frame."""
    base = Pose(ca.SX(ca.DM.eye(3)), ca.SX(3, 1))
    return [base, *recursion.link_poses(robot, motion)]


def numbers(values: Array) -> str:
    """Return numbers separated by commas; one number if all are equal."""
    return ", ".join(f"{v:.3g}" for v in (values[:1] if np.ptp(values) == 0.0 else values))
