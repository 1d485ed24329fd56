"""Reference motion of one joint forward and backward at constant speeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.errors import RobotError
from lieid_casadi.plant.trajectories import Envelope
from lieid_casadi.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sweep:
    """One joint forward and backward at constant speeds while the others hold their pose.

    Attributes
    ----------
    pose : (n,)
        Pose of the other joints; the moving joint starts at ``lower``.
    speeds : (S,)
        One run forward and one backward for each.
    """

    pose: Array
    joint: int
    lower: float
    upper: float
    speeds: tuple[float, ...]
    acceleration: float
    dwell: float

    def _run(self, speed: float) -> tuple[float, float]:
        """Ramp time and total time of one run."""
        ramp = (
            1.5 * speed / self.acceleration
        )  # the peak acceleration of the ramp is 1.5 of its mean
        return ramp, ramp + (self.upper - self.lower) / speed

    @property
    def duration(self) -> float:
        """Time from start to end, s."""
        return self.dwell + sum(2.0 * (self._run(speed)[1] + self.dwell) for speed in self.speeds)

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """q, dq, ddq (N, n) at times (N,)."""
        times = np.asarray(t, dtype=float)
        q = np.tile(self.pose, (times.size, 1))
        dq, ddq = np.zeros_like(q), np.zeros_like(q)
        q[:, self.joint] = self.lower
        begin = self.dwell
        for speed in self.speeds:
            ramp, total = self._run(speed)
            for origin, sign in ((self.lower, 1.0), (self.upper, -1.0)):
                on = times >= begin
                distance, velocity, change = _run(times[on] - begin, speed, ramp, total)
                q[on, self.joint] = origin + sign * distance
                dq[on, self.joint], ddq[on, self.joint] = sign * velocity, sign * change
                begin += total + self.dwell
        return q, dq, ddq


def sweep(
    robot: Robot,
    joint: int,
    *,
    speeds: Sequence[float] | None = None,
    pose: ArrayLike | None = None,
    dwell: float = 0.5,
) -> Sweep:
    """Return forward and backward runs of one joint across its range.

    Parameters
    ----------
    robot : Robot
    joint : int
        From 0.
    speeds : sequence of float, optional
        rad/s. Default: 5, 15 and 40 % of the joint's limit.
    pose : (n,), optional
        Of the other joints, rad. Default: the middle of the ranges.
    dwell : float
        At rest between two runs, s.

    Raises
    ------
    RobotError
        No such joint, or a speed that is not positive or for which the range is too short.
    """
    if not 0 <= joint < robot.n:
        raise RobotError(f"sweep of joint {joint} (from 0); robot {robot.name!r} has {robot.n}")
    envelope = Envelope.of(robot)
    lower, upper = float(envelope.lower[joint]), float(envelope.upper[joint])
    acceleration = float(envelope.acceleration[joint])
    limit = float(envelope.velocity[joint])
    chosen = tuple(float(x) for x in (speeds or (0.05 * limit, 0.15 * limit, 0.4 * limit)))
    for speed in chosen:
        if not 0.0 < 1.5 * speed * speed / acceleration < upper - lower:
            raise RobotError(
                f"sweep of joint {joint} (from 0) at {speed:g} rad/s does not fit its range"
            )
    middle = envelope.middle if pose is None else np.asarray(pose, dtype=float)
    return Sweep(middle, joint, lower, upper, chosen, acceleration, dwell)


def _run(t: Array, speed: float, ramp: float, total: float) -> tuple[Array, Array, Array]:
    """Return distance, velocity and acceleration of a run from rest to rest with smooth ramps."""
    up = np.clip(t / ramp, 0.0, 1.0)
    down = np.clip((t - (total - ramp)) / ramp, 0.0, 1.0)
    velocity = speed * (_smooth_step(up) - _smooth_step(down))
    acceleration = speed / ramp * (6.0 * up * (1.0 - up) - 6.0 * down * (1.0 - down))
    cruise = np.clip(t - ramp, 0.0, total - ramp)
    distance = speed * (
        ramp * _smooth_step_integral(up) + cruise - ramp * _smooth_step_integral(down)
    )
    return distance, velocity, acceleration


def _smooth_step(s: Array) -> Array:
    return s * s * (3.0 - 2.0 * s)


def _smooth_step_integral(s: Array) -> Array:
    return s**3 - 0.5 * s**4
