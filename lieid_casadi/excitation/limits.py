"""Limits on a motion: of joints, of the tool's speed, and of expressions of your own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import closed_form, recursion
from lieid_casadi.dynamics.lie import Motion, Pose, constant, cross
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.links import fixed_frames
from lieid_casadi.excitation.sample_functions import (
    SIGN_WIDTH,
    FittedArm,
    SampleKernel,
    motion_jacobian,
)
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.expressions.model_functions import ramp
from lieid_casadi.robot import Robot

ACCELERATION = 3.0  # rad/s² (m/s²) where the robot states none
LEAST_MOTION = 0.05  # rad; shorter durations are refused
SMOOTHING = 1e-4  # m/s; √(v² + SMOOTHING²) has a gradient at rest


class ConstraintSet(ABC):
    """Quantities of a motion sample that must stay between limits.

    Attributes
    ----------
    title : str
        Of the limit, in the lists of what was checked.
    labels : tuple of str
        Name of each quantity in messages.
    subjects : tuple of str
        Link, pair or joint that each quantity belongs to; several may belong to one.
    lower, upper : (k,)
        Infinite where there is no limit.
    scale : (k,)
        Unit in which violations of different quantities are compared.
    remedy : str
        What to relax, for messages.
    left_out : mapping
        Subject → why it is not checked.
    """

    title: str = ""
    labels: tuple[str, ...]
    subjects: tuple[str, ...] = ()
    units: tuple[str, ...]
    lower: Array
    upper: Array
    scale: Array
    remedy: str
    linear: bool = False
    left_out: Mapping[str, str] = {}

    @abstractmethod
    def values(self, motion: MotionSamples) -> Array:
        """Return the quantities (k, N)."""

    @abstractmethod
    def jacobian(self, motion: MotionSamples) -> Array:
        """Return ∂values/∂(q, dq, ddq) (k, 3 n, N), or by the jerk dddq, too (k, 4 n, N)."""

    def excess(self, values: Array) -> Array:
        """Return by how much values (k, N) exceed the limits, in their units; negative inside."""
        return np.maximum(values - self.upper[:, None], self.lower[:, None] - values)


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
    revolute: NDArray[np.bool_]

    @property
    def _stops(self) -> NDArray[np.bool_]:
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

    def constraint_set(self) -> JointLimits:
        """Return the limits as a constraint set."""
        return JointLimits(self)


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

    An acceleration, one number or (n,) in rad/s², replaces the robot's own; where neither is
    stated it is 3. An `ExcitationError` names a joint without a velocity limit, or with an empty
    range.
    """
    position = np.stack([robot.limit("position_lower"), robot.limit("position_upper")], axis=1)
    position = np.where(np.isnan(position), [-np.inf, np.inf], position)
    for j, (low, high) in enumerate(position):
        if not low < high:
            raise ExcitationError(
                f"robot {robot.name!r}: position limits of {_joint(robot, j)} contradict each "
                f"other: lower {low:g}, upper {high:g}"
            )
    if not 0.0 < margin <= 1.0:
        raise ExcitationError(f"margin: {margin:g}; expected more than 0, at most 1")
    velocity = margin * robot.limit("velocity")
    missing = [_joint(robot, j) for j in range(robot.n) if not velocity[j] > 0.0]
    if missing:
        raise ExcitationError(
            f"robot {robot.name!r} states no velocity limit for {', '.join(missing)}; "
            "add it to the robot's description"
        )
    revolute = np.array([joint.revolute for joint in robot.joints])
    return MotionRange(position, velocity, _acceleration(robot, acceleration), revolute)


def check_start_pose(robot: Robot, limits: MotionRange, pose: Array) -> None:
    """Refuse a start pose (n,) outside the position limits."""
    if pose.shape != (robot.n,) or not np.all(np.isfinite(pose)):
        raise ExcitationError(f"start pose: {pose.size} numbers; expected {robot.n}, one per joint")
    for j, (low, high) in enumerate(limits.position):
        if not low < pose[j] < high:
            raise ExcitationError(
                f"start pose: {_joint(robot, j)} at {pose[j]:g}, outside its position limits "
                f"{low:g} … {high:g}"
            )


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
                f"{_joint(robot, j)}, {limit[j]:g}: its amplitude would be {reach[j]:.2g} rad; "
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


def _joint(robot: Robot, j: int) -> str:
    return f"joint {j + 1} ({robot.joints[j].name})"


class SymbolicSet(ConstraintSet):
    """Quantities (k,) given as CasADi expressions of a motion's symbols.

    Jacobians (k, 3 n) are by differentiation where none are given. With a jerk's symbol the
    quantities may depend on it, too. ``facts`` are attributes of `ConstraintSet`.
    """

    def __init__(
        self,
        name: str,
        motion: Motion,
        quantities: ca.SX,
        jacobian: ca.SX | None = None,
        *,
        jerk: ca.SX | None = None,
        **facts: object,
    ) -> None:
        slopes = motion_jacobian(quantities, motion) if jacobian is None else jacobian
        further = {}
        if jerk is not None and ca.depends_on(quantities, jerk):
            further = {"dddq": jerk}
            slopes = ca.horzcat(slopes, ca.jacobian(quantities, jerk))
        self._needs_jerk = bool(further)
        vars(self).update(facts)
        if not quantities.numel():
            return
        name = "".join(c if c.isalnum() and c.isascii() else "_" for c in name)
        self._values = SampleKernel(name, motion, ca.densify(quantities), further)
        self._slopes = SampleKernel(f"{name}_jacobian", motion, slopes, further)

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        # identically zero quantities included
        return self._values.dense(motion, **self._inputs(motion))[:, 0]

    def jacobian(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return self._slopes.dense(motion, **self._inputs(motion))

    def _inputs(self, motion: MotionSamples) -> dict[str, Array]:
        if not self._needs_jerk:
            return {}
        if motion.dddq is None:
            raise ExcitationError(
                f"{self.labels[0]}: the jerk of this motion is not computed; leave the limit out"
            )
        return {"dddq": motion.dddq}


@dataclass(frozen=True)
class CartesianSpeed:
    """Speed of the tool, of every joint's centre and of the URDF's further frames within a limit.

    Parameters
    ----------
    limit : float
        m/s, above 0.
    """

    limit: float

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


@dataclass(frozen=True)
class Symbols:
    """Symbols of one sample of a motion, from which an `ExpressionLimit` is composed.

    Attributes
    ----------
    q, dq, ddq, dddq : SX (n,)
        Motion: rad, rad/s, rad/s², rad/s³ (m for prismatic joints).
    tau : SX (n,)
        Torque, N·m: of a fit with all effects, where excite designs for a fit; otherwise the
        rigid torque of the stated inertias.
    tool : SX (3,)
        Position of the tool in the base frame, m.
    """

    q: ca.SX
    dq: ca.SX
    ddq: ca.SX
    dddq: ca.SX
    tau: ca.SX
    tool: ca.SX


@dataclass(frozen=True)
class ExpressionLimit:
    """Quantities between bounds at every sample, as a function of `Symbols`.

    The expression is differentiated by CasADi, so it should be smooth where it is near a bound
    (a smooth maximum in place of ``fmax``, a squared length in place of a norm that may be 0).

    Attributes
    ----------
    name : str
        In messages and in the lists of what was checked.
    expression : callable
        `Symbols` → SX (k,). A function of a module, if an executor is used.
    lower, upper : float or (k,)
        Bounds; infinite where there is none.
    unit : str
        Of the quantities, in messages.

    Examples
    --------
    >>> import casadi as ca
    >>> power = ExpressionLimit("power", lambda s: ca.dot(s.tau, s.dq), upper=150.0, unit="W")
    """

    name: str
    expression: Callable[[Symbols], ca.SX]
    lower: ArrayLike = -np.inf
    upper: ArrayLike = np.inf
    unit: str = ""

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        motion, jerk = Motion.symbols(robot.n), ca.SX.sym("dddq", robot.n)
        values = ca.SX(self.expression(_symbols(robot, fit, motion, jerk)))
        if values.size2() != 1 or values.size1() == 0:
            raise ExcitationError(
                f"limit {self.name!r}: shape {values.shape}; expected a column of expressions"
            )
        count = values.size1()
        try:
            lower, upper = (
                np.broadcast_to(np.asarray(bound, dtype=float), count).copy()
                for bound in (self.lower, self.upper)
            )
        except ValueError:
            raise ExcitationError(
                f"limit {self.name!r}: expected one bound, or {count}, one per expression"
            ) from None
        if not np.all(lower < upper):
            raise ExcitationError(f"limit {self.name!r}: a lower bound is not below the upper one")
        sizes = [np.abs(np.where(np.isfinite(bound), bound, 0.0)) for bound in (lower, upper)]
        largest = np.maximum(*sizes)
        bounds = " and ".join(
            f"{word} {numbers(bound)}"
            for word, bound in (("at least", lower), ("at most", upper))
            if np.isfinite(bound).all()
        )
        names = [self.name] if count == 1 else [f"{self.name} {k + 1}" for k in range(count)]
        return SymbolicSet(
            f"limit_{self.name}", motion, values, jerk=jerk,
            title=f"{self.name} of {bounds} {self.unit}".rstrip(), labels=tuple(names),
            units=(self.unit,) * count, lower=lower, upper=upper,
            scale=np.where(largest > 0.0, largest, 1.0), remedy="its bounds, or a longer duration",
        )  # fmt: skip


def jerk_limit(limit: ArrayLike) -> ExpressionLimit:
    """Return the limit that every joint's jerk stays within ± a limit.

    Parameters
    ----------
    limit : float or (n,)
        rad/s³, above 0.

    Raises
    ------
    ExcitationError
        A limit that is not positive.
    """
    bound = np.asarray(limit, dtype=float)
    if not np.all(bound > 0.0):
        raise ExcitationError(f"jerk: {bound}; expected positive numbers, rad/s³")
    return ExpressionLimit("jerk", attrgetter("dddq"), lower=-bound, upper=bound, unit="rad/s³")


def _symbols(robot: Robot, fit: FittedArm | None, motion: Motion, jerk: ca.SX) -> Symbols:
    if fit is None:
        links = ca.SX(ca.DM(robot.link_parameters))
        torque = recursion.inverse_dynamics(robot, motion, links)
    else:
        sign = ramp(motion.dq, ca.SX(ca.DM(SIGN_WIDTH * robot.limit("velocity"))))
        torque = fit.torque_columns(motion, sign, sign[0], ca.SX(0.0))[:, 0]
    tool = recursion.tool_in_base(robot, motion).translation
    return Symbols(motion.q, motion.dq, motion.ddq, jerk, ca.densify(torque), ca.densify(tool))


def numbers(values: Array) -> str:
    """Return numbers separated by commas; one number if all are equal."""
    return ", ".join(f"{v:.3g}" for v in (values[:1] if np.ptp(values) == 0.0 else values))
