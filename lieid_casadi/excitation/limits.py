"""Limits on a motion: of joints, of the tool's speed, and of expressions of your own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import recursion
from lieid_casadi.dynamics.lie import (
    Motion,
    Pose,
    axes,
    constant,
    cross,
    inverse_adjoint_times,
    relative_poses,
)
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.sample_functions import (
    SIGN_WIDTH,
    FittedArm,
    SampleKernel,
    motion_jacobian,
)
from lieid_casadi.excitation.trajectory import MotionSamples, SampledBasis
from lieid_casadi.expressions.model_functions import ramp
from lieid_casadi.robot.robot import Robot


class ConstraintSet(ABC):
    """Quantities of a motion sample that must stay between limits.

    Attributes
    ----------
    labels : tuple of str
        Name of each quantity in messages.
    units : tuple of str
    lower, upper : (k,)
        Infinite where there is no limit.
    scale : (k,)
        Unit in which violations of different quantities are compared.
    remedy : str
        What to relax, for messages.
    left_out : tuple of str
        Quantities that are not checked.
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    lower: Array
    upper: Array
    scale: Array
    remedy: str
    linear: bool = False
    left_out: tuple[str, ...] = ()

    @abstractmethod
    def values(self, motion: MotionSamples) -> Array:
        """Return the quantities (k, N)."""

    @abstractmethod
    def jacobian(self, motion: MotionSamples) -> Array:
        """Return ∂values/∂(q, dq, ddq) (k, 3 n, N), or by the jerk dddq, too (k, 4 n, N)."""

    def excess(self, values: Array) -> Array:
        """Return by how much values (k, N) exceed the limits, in their units; negative inside."""
        return np.maximum(values - self.upper[:, None], self.lower[:, None] - values)


class UncheckedSet(ConstraintSet):
    """A set of a limit none of whose quantities can be checked; without quantities."""

    labels = units = ()
    lower = upper = scale = np.zeros(0)
    remedy = ""

    def __init__(self, left_out: Sequence[str]) -> None:
        self.left_out = tuple(left_out)

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return np.zeros((0, len(motion)))

    def jacobian(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return np.zeros((0, 3 * motion.q.shape[1], len(motion)))


class JointLimits(ConstraintSet):
    """Position, velocity and acceleration of each joint.

    Parameters
    ----------
    position : (n, 2)
        Lower and upper, rad.
    velocity, acceleration : (n,)
        rad/s, rad/s².
    revolute : (n,), optional
        Whether each joint is revolute; decides the units in messages.
    """

    linear = True
    remedy = "a longer duration, fewer harmonics or wider joint limits"

    def __init__(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        *,
        revolute: NDArray[np.bool_] | None = None,
    ) -> None:
        n = len(velocity)
        turns = np.ones(n, dtype=bool) if revolute is None else revolute
        self.lower = np.concatenate([position[:, 0], -velocity, -acceleration])
        self.upper = np.concatenate([position[:, 1], velocity, acceleration])
        half = 0.5 * (position[:, 1] - position[:, 0])
        self.scale = np.concatenate(
            [np.where(np.isfinite(half), half, np.pi), velocity, acceleration]
        )
        kinds = ("position", "velocity", "acceleration")
        self.labels = tuple(f"{kind} of joint {j + 1}" for kind in kinds for j in range(n))
        self.units = tuple(
            ("rad" if turn else "m") + suffix for suffix in ("", "/s", "/s²") for turn in turns
        )
        self._n = n

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return np.concatenate([motion.q.T, motion.dq.T, motion.ddq.T])

    def jacobian(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        identity = np.eye(3 * self._n)[:, :, None]
        return np.broadcast_to(identity, (3 * self._n, 3 * self._n, len(motion)))


@dataclass(frozen=True, eq=False)
class ConstraintRows:
    """Selected limits at selected samples: set, quantity, sample, side (+1 upper, −1 lower)."""

    sets: NDArray[np.intp]
    quantities: NDArray[np.intp]
    samples: NDArray[np.intp]
    sides: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.sets)

    @cached_property
    def keys(self) -> set[tuple[int, int, int, int]]:
        """The rows as tuples."""
        columns = (self.sets, self.quantities, self.samples, self.sides)
        return set(zip(*(column.tolist() for column in columns), strict=True))

    def without(self, other: ConstraintRows) -> ConstraintRows:
        """Return the rows that are not among the other's."""
        keys = zip(*(column.tolist() for column in self.columns), strict=True)
        return self.chosen(np.array([key not in other.keys for key in keys], dtype=bool))

    def joined(self, other: ConstraintRows) -> ConstraintRows:
        """Return these rows and the other's that are not among them."""
        new = other.without(self)
        pairs = zip(self.columns, new.columns, strict=True)
        return ConstraintRows(*(np.concatenate(pair) for pair in pairs))

    @property
    def columns(self) -> tuple[NDArray[np.intp], ...]:
        """The four arrays."""
        return self.sets, self.quantities, self.samples, self.sides

    def chosen(self, mask: NDArray[np.bool_]) -> ConstraintRows:
        """Return some of the rows."""
        return ConstraintRows(*(column[mask] for column in self.columns))


class SampledConstraints:
    """Constraint sets on a grid of times, as scaled excesses of the free variables z.

    The excess is the distance beyond a limit in parts of its scale, plus ``margin``: a motion with
    nonpositive excess keeps the margin from every limit.

    Parameters
    ----------
    sets : tuple of ConstraintSet
    sampled : SampledBasis
        Grid of times.
    margin : float
    """

    def __init__(
        self, sets: tuple[ConstraintSet, ...], sampled: SampledBasis, *, margin: float
    ) -> None:
        self.sets = sets
        self.sampled = sampled
        self.margin = margin

    def excess(self, motion: MotionSamples) -> list[tuple[Array, Array]]:
        """Return per set the scaled excesses (k, N) above the upper and below the lower limits."""
        result = []
        for limits in self.sets:
            values, scale = limits.values(motion), limits.scale[:, None]
            result.append(
                (
                    (values - limits.upper[:, None]) / scale + self.margin,
                    (limits.lower[:, None] - values) / scale + self.margin,
                )
            )
        return result

    def largest(self, excess: list[tuple[Array, Array]]) -> float:
        """Return the largest scaled excess."""
        return max(float(side.max()) for pair in excess for side in pair)

    def peaks(self, excess: list[tuple[Array, Array]], threshold: float) -> ConstraintRows:
        """Return the local maxima over time of excesses above a threshold."""
        found: list[tuple[NDArray[np.intp], ...]] = []
        for index, pair in enumerate(excess):
            for side, values in zip((1, -1), pair, strict=True):
                before, after = np.roll(values, 1, axis=1), np.roll(values, -1, axis=1)
                quantity, sample = np.nonzero(
                    (values > threshold) & (values >= before) & (values > after)
                )
                found.append(
                    (np.full_like(quantity, index), quantity, sample, np.full_like(quantity, side))
                )
        return ConstraintRows(*(np.concatenate(column) for column in zip(*found, strict=True)))

    def at(self, excess: list[tuple[Array, Array]], rows: ConstraintRows) -> Array:
        """Return the excesses of rows (R,)."""
        result = np.empty(len(rows))
        for index, (upper, lower) in enumerate(excess):
            own = rows.sets == index
            where = rows.quantities[own], rows.samples[own]
            result[own] = np.where(rows.sides[own] > 0, upper[where], lower[where])
        return result

    def jacobian(self, motion: MotionSamples, rows: ConstraintRows) -> Array:
        """Return ∂excess/∂z (R, n d) of rows."""
        functions = self.sampled.functions  # (n, 4, N, d)
        n, _, _, d = functions.shape
        result = np.zeros((len(rows), n, d))
        for index, limits in enumerate(self.sets):
            own = np.flatnonzero(rows.sets == index)
            if not len(own):
                continue
            samples, place = np.unique(rows.samples[own], return_inverse=True)
            slopes = limits.jacobian(motion.at(samples))
            kinds = slopes.shape[1] // n  # of derivatives of the position, itself included
            slopes = slopes[rows.quantities[own], :, place]  # (R, kinds n)
            factor = rows.sides[own] / limits.scale[rows.quantities[own]]
            slopes = (slopes * factor[:, None]).reshape(-1, kinds, n)
            result[own] = np.einsum(
                "rkj,jkrd->rjd", slopes, functions[:, :kinds, rows.samples[own], :], optimize=True
            )
        return result.reshape(len(rows), n * d)


ACCELERATION = 3.0  # rad/s² (m/s²) where the robot states none
LEAST_MOTION = 0.05  # rad; shorter durations are refused


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
        return JointLimits(self.position, self.velocity, self.acceleration, revolute=self.revolute)


def motion_range(
    robot: Robot, acceleration: ArrayLike | None = None, *, margin: float = 1.0
) -> MotionRange:
    """Return the limits of a robot.

    Parameters
    ----------
    robot : Robot
    acceleration : float or (n,), optional
        In place of the robot's own, rad/s². Default: 3 rad/s² (m/s²) where it states none.
    margin : float
        Part of the velocity limits that is used.

    Raises
    ------
    ExcitationError
        No velocity limit, an empty position range, or an acceleration that is not positive.
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
    """Refuse a start pose outside the position limits.

    Parameters
    ----------
    robot : Robot
    limits : MotionRange
    pose : (n,)
        rad.

    Raises
    ------
    ExcitationError
    """
    if pose.shape != (robot.n,) or not np.all(np.isfinite(pose)):
        raise ExcitationError(f"start pose: {pose.size} numbers; expected {robot.n}, one per joint")
    for j, (low, high) in enumerate(limits.position):
        if not low < pose[j] < high:
            raise ExcitationError(
                f"start pose: {_joint(robot, j)} at {pose[j]:g}, outside its position limits "
                f"{low:g} … {high:g}"
            )


def check_duration(robot: Robot, limits: MotionRange, duration: float) -> None:
    """Refuse a duration in which the limits allow less than 0.05 rad of motion.

    Parameters
    ----------
    robot : Robot
    limits : MotionRange
    duration : float
        Of one period, s.

    Raises
    ------
    ExcitationError
        Names the limit and a sufficient duration.
    """
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


SMOOTHING = 1e-4  # m/s; √(v² + SMOOTHING²) has a gradient at rest


class Limit(Protocol):
    """A limit that a caller specifies; for a robot it becomes a constraint set."""

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """Return the set for a robot; None if no motion of the robot can violate the limit.

        Parameters
        ----------
        robot : Robot
        fit : FittedArm, optional
            Identified parameters, for limits that depend on the torque.

        Raises
        ------
        ExcitationError
            The robot lacks what the limit needs.
        """


def sets_of(
    limits: Sequence[Limit], robot: Robot, fit: FittedArm | None
) -> tuple[tuple[ConstraintSet, ...], tuple[str, ...]]:
    """Return the constraint sets of limits, and the quantities that they leave out.

    Parameters
    ----------
    limits : sequence of Limit
    robot : Robot
    fit : FittedArm or None

    Raises
    ------
    ExcitationError
        One of them is not a limit.
    """
    for limit in limits:
        if not hasattr(limit, "on"):
            raise ExcitationError(f"limits: {limit!r:.60}; expected limits, such as Torque()")
    made = [s for s in (limit.on(robot, fit) for limit in limits) if s is not None]
    left_out = dict.fromkeys(label for s in made for label in s.left_out)
    return tuple(s for s in made if s.labels), tuple(left_out)


class SymbolicSet(ConstraintSet):
    """Quantities given as CasADi expressions, with exact Jacobians.

    Parameters
    ----------
    name : str
        Of the functions; letters, digits and underscores.
    symbols : Motion
        Of the motion.
    quantities : SX (k,)
    jacobian : SX (k, 3 n), optional
        ∂quantities/∂(q, dq, ddq). Default: by differentiation.
    labels, units, lower, upper, scale, remedy, left_out
        See `ConstraintSet`.
    """

    def __init__(
        self,
        name: str,
        symbols: Motion,
        quantities: ca.SX,
        jacobian: ca.SX | None = None,
        *,
        labels: Sequence[str],
        units: Sequence[str],
        lower: Array,
        upper: Array,
        scale: Array,
        remedy: str,
        left_out: Sequence[str] = (),
    ) -> None:
        slopes = motion_jacobian(quantities, symbols) if jacobian is None else jacobian
        self._values = SampleKernel(name, symbols, ca.densify(quantities))
        self._slopes = SampleKernel(f"{name}_jacobian", symbols, slopes)
        self.labels, self.units = tuple(labels), tuple(units)
        self.lower, self.upper, self.scale = lower, upper, scale
        self.remedy, self.left_out = remedy, tuple(left_out)

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return self._values.dense(motion)[:, 0]  # identically zero quantities included

    def jacobian(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
        return self._slopes.dense(motion)


@dataclass(frozen=True)
class CartesianSpeed:
    """Speed of the tool and of every joint's centre within a limit.

    Parameters
    ----------
    limit : float
        m/s, above 0.
    """

    limit: float

    def on(self, robot: Robot, fit: FittedArm | None = None) -> ConstraintSet | None:
        """See `Limit`."""
        _positive("Cartesian speed", self.limit)
        symbols = Motion.symbols(robot.n)
        twists = link_twists(robot, symbols)
        points = [(f"centre of joint {i + 1}", v, np.zeros(3)) for i, v in enumerate(twists)]
        points.append(("tool", twists[-1], robot.tool[:3, 3]))
        labels, speeds = [], []
        for label, twist, point in points:
            squared = ca.sumsqr(twist[3:] + cross(twist[:3], constant(point)))
            if ca.depends_on(squared, symbols.dq):
                labels.append(f"speed of the {label}")
                speeds.append(ca.sqrt(squared + SMOOTHING**2))
        return SymbolicSet(
            "speed", symbols, ca.vertcat(*speeds), labels=labels, units=["m/s"] * len(labels),
            lower=np.full(len(labels), -np.inf), upper=np.full(len(labels), self.limit),
            scale=np.full(len(labels), self.limit),
            remedy="a longer duration or a higher Cartesian speed",
        )  # fmt: skip


def link_twists(robot: Robot, symbols: Motion) -> list[ca.SX]:
    """Return the twist [ω; v] (6,) of every link, in its own frame (Eq. 2)."""
    twist, twists = ca.SX(6, 1), []
    for i, (g, xi) in enumerate(zip(relative_poses(robot, symbols), axes(robot), strict=True)):
        twist = inverse_adjoint_times(g, twist) + xi * symbols.dq[i]
        twists.append(twist)
    return twists


def link_poses(robot: Robot, symbols: Motion) -> list[Pose]:
    """Return the frames of the base and of every link, in the base frame."""
    poses = [Pose(ca.SX(ca.DM.eye(3)), ca.SX(3, 1))]
    for g in relative_poses(robot, symbols):
        poses.append(poses[-1] @ g)
    return poses


def _positive(name: str, value: float) -> None:
    if not value > 0.0:
        raise ExcitationError(f"{name}: {value:g}; expected a positive number")


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
        return ExpressionSet(self, robot, fit)


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


class ExpressionSet(ConstraintSet):
    """The constraint set of an `ExpressionLimit`.

    Parameters
    ----------
    limit : ExpressionLimit
    robot : Robot
    fit : FittedArm or None

    Raises
    ------
    ExcitationError
        The expression is not a column of symbols, or the bounds do not fit it.
    """

    remedy = "its bounds, or a longer duration"

    def __init__(self, limit: ExpressionLimit, robot: Robot, fit: FittedArm | None) -> None:
        motion = Motion.symbols(robot.n)
        jerk = ca.SX.sym("dddq", robot.n)
        values = ca.SX(limit.expression(_symbols(robot, fit, motion, jerk)))
        if values.size2() != 1 or values.size1() == 0:
            raise ExcitationError(
                f"limit {limit.name!r}: shape {values.shape}; expected a column of expressions"
            )
        count = values.size1()
        try:
            self.lower, self.upper = (
                np.broadcast_to(np.asarray(bound, dtype=float), count).copy()
                for bound in (limit.lower, limit.upper)
            )
        except ValueError:
            raise ExcitationError(
                f"limit {limit.name!r}: expected one bound, or {count}, one per expression"
            ) from None
        if not np.all(self.lower < self.upper):
            raise ExcitationError(f"limit {limit.name!r}: a lower bound is not below the upper one")
        self._needs_jerk = bool(ca.depends_on(values, jerk))
        further = {"dddq": jerk} if self._needs_jerk else {}
        slopes = motion_jacobian(values, motion)
        if self._needs_jerk:
            slopes = ca.horzcat(slopes, ca.jacobian(values, jerk))
        name = "limit_" + "".join(c if c.isalnum() and c.isascii() else "_" for c in limit.name)
        self._values = SampleKernel(name, motion, ca.densify(values), further)
        self._slopes = SampleKernel(f"{name}_jacobian", motion, slopes, further)
        numbers = [""] if count == 1 else [f" {k + 1}" for k in range(count)]
        self.labels = tuple(f"{limit.name}{number}" for number in numbers)
        self.units = (limit.unit,) * count
        self.scale = _scale(self.lower, self.upper)

    def values(self, motion: MotionSamples) -> Array:
        """See `ConstraintSet`."""
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


def _scale(lower: Array, upper: Array) -> Array:
    """Return the sizes (k,) by which violations are compared: those of the bounds."""
    sizes = [np.abs(np.where(np.isfinite(bound), bound, 0.0)) for bound in (lower, upper)]
    largest = np.maximum(*sizes)
    return np.where(largest > 0.0, largest, 1.0)


def _symbols(robot: Robot, fit: FittedArm | None, motion: Motion, jerk: ca.SX) -> Symbols:
    if fit is None:
        links = ca.SX(ca.DM(robot.link_parameters))
        torque = recursion.inverse_dynamics(robot, motion, links)
    else:
        sign = ramp(motion.dq, ca.SX(ca.DM(SIGN_WIDTH * robot.limit("velocity"))))
        torque = fit.torque_columns(motion, sign, sign[0], ca.SX(0.0))[:, 0]
    tool = recursion.tool_in_base(robot, motion).translation
    return Symbols(motion.q, motion.dq, motion.ddq, jerk, ca.densify(torque), ca.densify(tool))
