"""Reference motions of quintics between knots: moves between poses, sweeps of one joint."""

import numpy as np
from scipy.interpolate import BPoly

from lieid_casadi.plant.trajectories import Envelope

REST = 0.5  # s, between two runs of a sweep


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


def constant_speeds(robot, joint, *, speeds, pose):
    """Forward and backward runs of one joint across its range at speeds in rad/s."""
    envelope = Envelope.of(robot)
    lower, upper = float(envelope.lower[joint]), float(envelope.upper[joint])
    knots = [(0.0, lower, 0.0)]  # time, position, speed; accelerations are zero there
    for speed in speeds:
        ramp = 1.5 * speed / float(envelope.acceleration[joint])  # peaks are 1.5 of the mean
        total = ramp + (upper - lower) / speed
        for start, end, v in ((lower, upper, speed), (upper, lower, -speed)):
            begin = knots[-1][0] + REST
            knots += [
                (begin, start, 0.0),
                (begin + ramp, start + 0.5 * ramp * v, v),
                (begin + total - ramp, end - 0.5 * ramp * v, v),
                (begin + total, end, 0.0),
            ]
    knots.append((knots[-1][0] + REST, lower, 0.0))
    times, positions, velocities = np.array(knots).T
    q = np.tile(np.asarray(pose, dtype=float), (len(times), 1))
    dq = np.zeros_like(q)
    q[:, joint], dq[:, joint] = positions, velocities
    return PolynomialPath(times, q, dq)
