"""Limits on a motion: of joints, of expressions of its symbols, of speed and of torque."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
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
from lieid_casadi.excitation.sample_functions import (
    SIGN_WIDTH,
    FittedArm,
    SampleKernel,
    motion_jacobian,
    reverse_derivative,
)
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.expressions.model_functions import ramp
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


DRY_FRICTION = 0.1  # of the torque limit: allowance where no fit is given
VISCOUS_FRICTION = 0.4  # of the torque limit at the velocity limit: the same
DEVIATIONS = 2.0  # standard deviations of the fit's torque that are added
LEAST_DEVIATION = 1e-9  # N·m; keeps the derivative of the deviation finite
SHIFTS = (1.0, -1.0)  # of the smooth bounds, in parts of their width
REMEDY = "a longer duration, lower acceleration limits or another start pose"


@dataclass(frozen=True)
class Torque:
    """Torque of the drives within ``fraction`` of the robot's torque limits.

    For a fit it is the torque of the identified links and of all effects, plus or minus two
    standard deviations. For a model without a fit it is the rigid torque of the
    stated inertias, with an allowance for friction in parts of the torque limit: ``dry`` at any
    speed, and ``viscous`` in proportion to the speed, at the velocity limit. The UR10e's friction
    is 0.06 and 0.25 to 0.41 of it.
    """

    fraction: float = 1.0  #: of the torque limits
    dry: float = DRY_FRICTION
    viscous: float = VISCOUS_FRICTION

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        torque = torque_limits(robot)
        limited = [j for j in range(robot.n) if np.isfinite(torque[j])]
        if not limited:
            raise ExcitationError(f"robot {robot.name!r} states no torque limits")
        if fit is not None:
            return FittedTorqueSet(self, fit, limited)
        if not 0.0 <= self.dry < self.fraction or self.viscous < 0.0:
            raise ExcitationError(
                f"torque limit: {self.fraction:g} of the robot's, of which {self.dry:g} is the "
                "allowance for friction; expected a larger margin, or a fit in place of the model"
            )
        return self._with_allowance(robot, limited)

    def _with_allowance(self, robot: Robot, limited: list[int]) -> ConstraintSet:
        symbols = Motion.symbols(robot.n)
        torque, velocity = robot.limit("torque"), robot.limit("velocity")
        parameters = ca.SX(ca.DM(robot.link_parameters))
        rigid = recursion.inverse_dynamics(robot, symbols, parameters)[limited]
        bound = (self.fraction - self.dry) * torque[limited]
        slope = self.viscous * torque / np.where(np.isfinite(velocity), velocity, np.inf)
        # friction acts along the motion: the torque lies between that without and with it
        parts, joints = [rigid], joint_names(limited)
        labels = [f"torque of {joint}" for joint in joints]
        if self.viscous > 0.0:
            parts.append(rigid + ca.DM(slope[limited]) * symbols.dq[limited])
            labels += [f"torque of {joint} with friction" for joint in joints]
        count = len(parts)
        return SymbolicSet(
            "torque", symbols, ca.vertcat(*parts), labels=tuple(labels), subjects=joints * count,
            units=_units(robot, limited) * count, lower=np.tile(-bound, count),
            upper=np.tile(bound, count), scale=np.tile(self.fraction * torque[limited], count),
            remedy=REMEDY, left_out=_without_limit(robot, limited),
            title=f"torque within {self.fraction:g} of its limits, by the stated inertias, with "
            f"{self.dry:g} of the limit for friction and up to {self.viscous:g} more in "
            "proportion to the speed",
        )  # fmt: skip


def torque_limits(robot: Robot) -> Array:
    """Return the torque limits (n,), N·m; NaN where there is none to compare a torque with.

    Torques of a drive of unknown stiffness are in units of it.
    """
    relative = np.array([j.drive is not None and j.drive.relative for j in robot.joints])
    return np.where(relative, np.nan, robot.limit("torque"))


class FittedTorqueSet(ConstraintSet):
    """Largest and smallest torque of each joint, by a fit and its uncertainty.

    Dry friction jumps at reversals, where both directions occur. The torque is evaluated with a
    smooth function above sgn(q̇), and with one below it; each equals sgn(q̇) on one side, so that
    the exact torque is one of the two and their extremes are bounds. Friction with memory builds
    up after a reversal; there both directions are taken everywhere.
    """

    remedy = REMEDY

    def __init__(self, limit: Torque, fit: FittedArm, limited: list[int]) -> None:
        robot = fit.model.robot
        self._root = fit.covariance_root
        self.title = (
            f"torque within {limit.fraction:g} of its limits, by the fit with all effects, "
            f"± {DEVIATIONS:g} standard deviations"
        )
        self.left_out = _without_limit(robot, limited)
        symbols = Motion.symbols(robot.n)
        shift, time = ca.SX.sym("shift"), ca.SX.sym("time")
        width = ca.SX(ca.DM(SIGN_WIDTH * robot.limit("velocity")))
        self._near = 2.0 * SIGN_WIDTH * robot.limit("velocity")
        if fit.model.states:
            self._near = np.full(robot.n, np.inf)
        sign = ramp(symbols.dq + shift * width, width)
        columns = ca.densify(fit.torque_columns(symbols, sign, shift, time)[limited, :])
        seeds = ca.SX.sym("seeds", columns.numel())
        slopes = [
            reverse_derivative(row.T, seed, symbols).T
            for row, seed in zip(
                ca.vertsplit(columns), ca.vertsplit(seeds, columns.shape[1]), strict=True
            )
        ]
        inputs = {"shift": shift, "time": time}
        self._columns = SampleKernel("fitted_torque", symbols, columns, inputs)
        self._slopes = SampleKernel(
            "fitted_torque_slopes", symbols, ca.vertcat(*slopes), {"seeds": seeds, **inputs}
        )
        edge = limit.fraction * torque_limits(robot)[limited]
        endless, joints = np.full(len(limited), np.inf), joint_names(limited)
        self.labels = tuple(
            f"{side} torque of {joint}" for side in ("largest", "smallest") for joint in joints
        )
        self.subjects = joints * 2
        self.units = _units(robot, limited) * 2
        self.upper, self.lower = np.concatenate([edge, endless]), np.concatenate([-endless, -edge])
        self.scale = np.tile(edge, 2)

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        largest, smallest, _ = self._bounds(motion, SHIFTS[0])
        # far from reversals both bounds of the sign are the sign
        near = np.flatnonzero((np.abs(motion.dq) < self._near).any(axis=1))
        if len(near):
            high, low, _ = self._bounds(motion.at(near), SHIFTS[1])
            largest[:, near] = np.maximum(largest[:, near], high)
            smallest[:, near] = np.minimum(smallest[:, near], low)
        return np.concatenate([largest, smallest])

    def jacobian(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        parts = []
        for shift in SHIFTS:
            largest, smallest, spread = self._bounds(motion, shift)
            own = [self._slopes_of(motion, shift, side * spread) for side in (1.0, -1.0)]
            parts.append((largest, smallest, *own))
        (high, low, *above), (other_high, other_low, *below) = parts
        return np.concatenate(
            [
                np.where((high >= other_high)[:, None], above[0], below[0]),
                np.where((low <= other_low)[:, None], above[1], below[1]),
            ]
        )

    def _bounds(self, motion: MotionSamples, shift: float) -> tuple[Array, Array, Array]:
        """Return torque plus and minus its deviation (k, N), and the latter's seeds (k, m, N)."""
        columns = self._columns.dense(motion, **self._inputs(motion, shift))
        spread = np.einsum("kpn,pr->krn", columns[:, 1:], self._root, optimize=True)
        deviation = np.sqrt((spread**2).sum(axis=1) + LEAST_DEVIATION**2)
        seeds = np.einsum("krn,pr->kpn", spread / deviation[:, None], self._root, optimize=True)
        margin = DEVIATIONS * deviation
        return columns[:, 0] + margin, columns[:, 0] - margin, DEVIATIONS * seeds

    def _slopes_of(self, motion: MotionSamples, shift: float, seeds: Array) -> Array:
        """Return ∂(column 0 + seeds · other columns)/∂(q, dq, ddq) (k, 3 n, N)."""
        full = np.concatenate([np.ones((len(seeds), 1, len(motion))), seeds], axis=1)
        given = np.ascontiguousarray(full.reshape(-1, len(motion)).T)
        return self._slopes.dense(motion, seeds=given, **self._inputs(motion, shift))

    def _inputs(self, motion: MotionSamples, shift: float) -> dict[str, Array]:
        return {"shift": np.full((len(motion), 1), shift), "time": motion.t[:, None]}


def joint_names(joints: Iterable[int]) -> tuple[str, ...]:
    """Return the names of joints, numbered from 1, in the lists of what was checked."""
    return tuple(f"joint {j + 1}" for j in joints)


def _without_limit(robot: Robot, limited: list[int]) -> dict[str, str]:
    others = (j for j in range(robot.n) if j not in limited)
    return dict.fromkeys(joint_names(others), "no torque limit is stated")


def _units(robot: Robot, joints: list[int]) -> tuple[str, ...]:
    return tuple("N·m" if robot.joints[j].revolute else "N" for j in joints)
