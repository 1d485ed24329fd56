"""Limit on the joint torque: of a fit with its uncertainty, or of stated inertias and friction."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import recursion
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.limits import ConstraintSet, SymbolicSet
from lieid_casadi.excitation.sample_functions import (
    SIGN_WIDTH,
    FittedArm,
    SampleKernel,
    reverse_derivative,
)
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.expressions.model_functions import ramp
from lieid_casadi.robot.robot import Robot

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
