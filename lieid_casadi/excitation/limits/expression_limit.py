"""Limits of your own: CasADi expressions of the motion, the torque and the tool's position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.dynamics import recursion
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.excitation.fitted_arm import FittedArm
from lieid_casadi.excitation.limits.constraint_sets import ConstraintSet
from lieid_casadi.excitation.limits.torque_limit import SIGN_WIDTH
from lieid_casadi.excitation.sample_functions import SampleKernel, motion_jacobian
from lieid_casadi.expressions.model_functions import ramp
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]


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
