"""Reference motions: random Fourier series within the limits of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RobotError
from lieid_casadi.robot import Robot
from lieid_casadi.robot.pinocchio_model import build_pinocchio

DEFAULT_ACCELERATION = 5.0  # rad/s² (m/s²) where the robot states no limit
DEFAULT_VELOCITY = {True: 2.0, False: 0.5}  # rad/s revolute, m/s sliding
DEFAULT_REACH = {True: np.pi, False: 0.5}  # rad, m either side


class ReferenceTrajectory(Protocol):
    """A reference for the controller; at rest before 0 and after ``duration`` (s)."""

    @property
    def duration(self) -> float:
        """Time from start to end, s."""
        ...

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """q, dq, ddq (N, n) at times (N,)."""
        ...


@dataclass(frozen=True, eq=False)
class Envelope:
    """Limits of the motions, (n,) each: those of the robot, or defaults where it states none."""

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def of(cls, robot: Robot, *, margin: float = 0.9) -> Envelope:
        """Return the part ``margin`` of a robot's ranges and speeds."""
        revolute = [joint.revolute for joint in robot.joints]
        reach = np.array([DEFAULT_REACH[kind] for kind in revolute])

        def limit(name: str, default: Array | float) -> Array:
            stated = robot.limit(name)
            return np.where(np.isfinite(stated), stated, default)

        lower, upper = limit("position_lower", -reach), limit("position_upper", reach)
        middle = 0.5 * (lower + upper)
        half = margin * np.minimum(0.5 * (upper - lower), reach)
        velocity = limit("velocity", np.array([DEFAULT_VELOCITY[kind] for kind in revolute]))
        acceleration = np.minimum(limit("acceleration", np.inf), DEFAULT_ACCELERATION)
        return cls(middle - half, middle + half, margin * velocity, margin * acceleration)

    @property
    def middle(self) -> Array:
        """Middle of the ranges (n,)."""
        return 0.5 * (self.lower + self.upper)


def torque_scale(robot: Robot) -> Array:
    """Return the torque limit of each joint (n,), N·m; without one, 1.5 × a typical peak."""
    import pinocchio as pin

    limit = robot.limit("torque")
    if np.isfinite(limit).all():
        return limit
    envelope, random = Envelope.of(robot), np.random.default_rng(0)
    model = build_pinocchio(robot)
    data = model.createData()
    peak = np.zeros(robot.n)
    for _ in range(200):
        q = random.uniform(envelope.lower, envelope.upper)
        dq, ddq = random.uniform(-0.5, 0.5, (2, robot.n))
        tau = pin.rnea(model, data, q, dq * envelope.velocity, ddq * envelope.acceleration)
        peak = np.maximum(peak, np.abs(tau))
    return np.where(np.isfinite(limit), limit, 1.5 * peak)


class FourierTrajectory:
    """A random periodic motion within the robot's limits, at rest at the start of each period.

    q(t) = q0 + Σ a_l/(lω)·sin(lωt) − b_l/(lω)·cos(lωt), with Σ a_l = Σ l·b_l = 0, so that
    velocity and acceleration vanish at the ends. Accelerations stay below 5 rad/s² and the robot's
    own limit. ``base_frequency`` (Hz) is one over the period; there are at least two harmonics.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        harmonics: int = 5,
        base_frequency: float = 0.1,
        periods: int = 1,
        seed: int,
    ) -> None:
        if harmonics < 2:
            raise RobotError(f"a Fourier trajectory of {harmonics} harmonics; expected at least 2")
        self.duration = periods / base_frequency
        self._multiples = np.arange(1, harmonics + 1)
        self._omega = 2.0 * np.pi * base_frequency * self._multiples
        random = np.random.default_rng(seed)
        ones, ranks = np.ones(harmonics), self._multiples.astype(float)
        self._a = _without(random.standard_normal((harmonics, robot.n)), ones)
        self._b = _without(random.standard_normal((harmonics, robot.n)), ranks)
        self._centre = np.zeros(robot.n)
        self._fit(Envelope.of(robot), random.uniform(0.7, 1.0, robot.n))

    def _fit(self, envelope: Envelope, amplitude: Array) -> None:
        fastest = float(self._omega[-1])
        one_period = np.linspace(0.0, 2.0 * np.pi / float(self._omega[0]), 200 * self._omega.size)
        q, dq, ddq = self.at(one_period)
        half = np.pi / 200.0 / fastest  # half the grid step; covers maxima between grid points
        scale = 0.998 * amplitude * np.min(
            [
                (envelope.upper - envelope.lower) / np.ptp(q, axis=0),
                envelope.velocity / (np.abs(dq).max(axis=0) + half * np.abs(ddq).max(axis=0)),
                envelope.acceleration / np.abs(ddq).max(axis=0),
            ],
            axis=0,
        )  # fmt: skip
        self._a *= scale
        self._b *= scale
        self._centre = envelope.middle - 0.5 * scale * (q.max(axis=0) + q.min(axis=0))

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """q, dq, ddq (N, n) at times (N,); at rest before the start and after the end."""
        times = np.asarray(t, dtype=float)
        inside = (times > 0.0) & (times < self.duration)
        phase = np.where(inside, times, 0.0)[:, None] * self._omega
        sine, cosine, w = np.sin(phase), np.cos(phase), self._omega[:, None]
        q = self._centre + sine @ (self._a / w) - cosine @ (self._b / w)
        dq = cosine @ self._a + sine @ self._b
        ddq = cosine @ (self._b * w) - sine @ (self._a * w)
        return q, dq * inside[:, None], ddq * inside[:, None]


def _without(coefficients: Array, direction: Array) -> Array:
    """Remove a direction (H,) from coefficients (H, n)."""
    unit = direction / np.linalg.norm(direction)
    return coefficients - np.outer(unit, unit @ coefficients)
