"""Motions of the benchmark: Fourier series, moves between poses, and mixtures of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly, CubicSpline
from scipy.ndimage import gaussian_filter1d

from lieid_casadi.arrays import Array
from lieid_casadi.plant import FourierTrajectory, ReferenceTrajectory
from lieid_casadi.plant.trajectories import Envelope
from lieid_casadi.robot import Robot

SAMPLE, WIDTH, MARGIN = 1e-3, 0.01, 0.06  # s: of smoothed motions, and what is added at the ends
PAUSE = 0.3  # s of rest at each end of a move between two motions


class PolynomialPath:
    """Quintics through knots (K,), (K, n), (K, n) without acceleration; at rest outside."""

    def __init__(self, times, q, dq):
        self.path = BPoly.from_derivatives(times, np.stack([q, dq, np.zeros_like(q)], axis=1))
        self.duration = float(self.path.x[-1])

    def at(self, t):
        given = np.asarray(t, dtype=float)
        times = np.clip(given, 0.0, self.duration)
        inside = ((given > 0.0) & (given < self.duration))[:, None]
        return self.path(times), self.path(times, 1) * inside, self.path(times, 2) * inside


def point_to_point(robot, *, poses=8, dwell=1.0, speed=0.7, seed):
    """Moves between random poses, at rest for ``dwell`` (s) between them.

    The fastest joint of a move reaches the part ``speed`` of its velocity limit.
    """
    envelope = Envelope.of(robot)
    random = np.random.default_rng(seed)
    stops = random.uniform(envelope.lower, envelope.upper, (poses, robot.n))
    distance = np.abs(np.diff(stops, axis=0))
    # A quintic has peaks of 15/8 of its mean velocity and 10/√3 of distance/time².
    by_velocity = 15.0 / 8.0 * distance / (speed * envelope.velocity)
    by_acceleration = np.sqrt(10.0 / np.sqrt(3.0) * distance / envelope.acceleration)
    times = np.maximum(np.maximum(by_velocity, by_acceleration).max(axis=1), 0.1)
    return moves_between(stops, times, dwell)


def moves_between(poses, times, dwell):
    """Moves from rest to rest between poses (P, n), in ``times`` (P − 1,), with dwells, s."""
    starts = dwell + np.concatenate([[0.0], np.cumsum(times[:-1] + dwell)])
    knots = np.column_stack([starts, starts + times]).ravel()
    knots = np.concatenate([[0.0], knots, [knots[-1] + dwell]])
    every = np.repeat(poses, 2, axis=0)
    return PolynomialPath(knots, every, np.zeros_like(every))


@dataclass(frozen=True, eq=False)
class Chain:
    """Motions one after another; quintic moves lead from each to the next."""

    parts: tuple[ReferenceTrajectory, ...]
    starts: tuple[float, ...]

    @property
    def duration(self) -> float:
        return self.starts[-1] + self.parts[-1].duration

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        times = np.asarray(t, dtype=float)
        which = np.clip(np.searchsorted(self.starts, times, side="right") - 1, 0, None)
        found = [np.empty((times.size, self._n)) for _ in range(3)]
        for k, (part, start) in enumerate(zip(self.parts, self.starts, strict=True)):
            here = which == k
            for whole, values in zip(found, part.at(times[here] - start), strict=True):
                whole[here] = values
        return found[0], found[1], found[2]

    @property
    def _n(self) -> int:
        return int(self.parts[0].at(np.zeros(1))[0].shape[1])


def chain(robot: Robot, motions: Sequence[ReferenceTrajectory]) -> Chain:
    """Return motions in a row, joined by moves from the end of one to the start of the next."""
    envelope = Envelope.of(robot)
    parts: list[ReferenceTrajectory] = [motions[0]]
    for motion in motions[1:]:
        last = parts[-1].at(np.array([parts[-1].duration]))[0][0]
        first = motion.at(np.zeros(1))[0][0]
        parts += [_move(envelope, last, first), motion]
    ends = np.cumsum([part.duration for part in parts])
    return Chain(tuple(parts), (0.0, *map(float, ends[:-1])))


def _move(envelope: Envelope, a: Array, b: Array) -> PolynomialPath:
    way = np.abs(b - a)
    by_velocity = 15.0 / 8.0 * way / (0.6 * envelope.velocity)
    by_acceleration = np.sqrt(10.0 / np.sqrt(3.0) * way / envelope.acceleration)
    time = max(float(np.maximum(by_velocity, by_acceleration).max()), 0.5)
    return moves_between(np.array([a, b]), np.array([time]), PAUSE)


class Smoothed:
    """A motion without jumps of its jerk: elastic joints react to derivatives up to q⁗."""

    def __init__(self, motion: ReferenceTrajectory) -> None:
        self.duration = motion.duration + 2.0 * MARGIN
        t = np.arange(0.0, self.duration + SAMPLE, SAMPLE)
        q = motion.at(np.clip(t - MARGIN, 0.0, motion.duration))[0]
        q = gaussian_filter1d(q, WIDTH / SAMPLE, axis=0, mode="nearest", truncate=6.0)
        self._path = CubicSpline(t, q)

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        times = np.clip(np.asarray(t, dtype=float), 0.0, self.duration)
        return self._path(times), self._path(times, 1), self._path(times, 2)


def draw_motion(robot: Robot, kind: str, duration: float, random: np.random.Generator) -> Chain:
    """Return a random motion of about this duration (s): ``fourier``, ``poses`` or ``mixture``."""
    if kind == "fourier":
        return chain(robot, [_fourier(robot, duration, random)])
    if kind == "poses":
        return chain(robot, [_poses(robot, duration, random)])
    half = 0.5 * duration
    both: list[ReferenceTrajectory] = [_fourier(robot, half, random), _poses(robot, half, random)]
    return chain(robot, both if random.random() < 0.5 else both[::-1])


def _fourier(robot: Robot, duration: float, random: np.random.Generator) -> FourierTrajectory:
    periods = int(random.choice([1, 1, 2, 3]))
    return FourierTrajectory(
        robot,
        harmonics=int(random.integers(4, 7)) + 2 * (3 - periods),
        base_frequency=periods / duration,
        periods=periods,
        seed=int(random.integers(2**31)),
    )


def _poses(robot: Robot, duration: float, random: np.random.Generator) -> PolynomialPath:
    """Return moves that last at least ``duration``, with as few poses as that takes."""
    seed, dwell = int(random.integers(2**31)), float(random.uniform(0.1, 0.8))
    speed, poses = float(random.uniform(0.5, 0.95)), 3
    while True:
        motion = point_to_point(robot, poses=poses, dwell=dwell, speed=speed, seed=seed)
        if motion.duration >= duration:
            return motion
        poses += 1
