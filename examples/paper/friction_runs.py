"""Forward and backward runs of single joints (6.4.2), in poses that load them."""

from __future__ import annotations

from functools import cache

import numpy as np
from arm import HEAVIEST, ROBOT, Array, N, with_payload

import lieid_casadi as lieid
from lieid_casadi.excitation.friction_sweep import friction_sweep

SWEEP_RATE = 200.0
SECONDS = 3.0  # of a run at constant speed
EDGE = np.deg2rad(50.0)  # least distance of the middle of a run from the joint limits
SWINGS = (0.5, 1.0, 2.0, 4.0)  # rad/s² of joint 1, whose load is inertia alone


@cache
def friction_runs(
    joint: int, speeds: tuple[float, ...], centres: int
) -> list[tuple[Array, Array, Array, Array]]:
    """Return t, q, dq, ddq of the runs of one joint (from 0), one for each of the centres."""
    pose, middles = _loading_pose(joint, centres)
    runs = []
    for centre in middles:
        start = pose.copy()
        start[joint] = centre
        sweep = friction_sweep(
            lieid.Model(ROBOT),
            joint,
            speeds=speeds,
            seconds=SECONDS,
            start_pose=start,
            margin=1.0,
            limits=[],  # a simulated arm without surroundings
            rate=SWEEP_RATE,
        ).motion
        runs.append((sweep.t, sweep.q, sweep.dq, sweep.ddq))
    if joint == 0:
        runs += [_swing(start, a, max(speeds)) for a in SWINGS]
    return runs


def _loading_pose(joint: int, count: int) -> tuple[Array, Array]:
    """Return a pose that loads a joint (from 0), and middle positions with small to large load.

    Of 400 random poses, that with the largest gravity torque under the heaviest payload within
    the torque limits of all joints; for joint 1 that with the largest inertia.
    """
    lower, upper = ROBOT.limit("position_lower") + EDGE, ROBOT.limit("position_upper") - EDGE
    random = np.random.default_rng(joint)
    path = np.linspace(lower[joint], upper[joint], 37)
    permitted = 0.8 * ROBOT.limit("torque")
    arm = lieid.compile(lieid.Model(ROBOT))
    links = with_payload(ROBOT.link_parameters, HEAVIEST)
    push = np.zeros((len(path), N))
    push[:, joint] = 1.0 if joint == 0 else 0.0
    best, largest = np.zeros(N), np.zeros(len(path))
    for _ in range(400):
        q = np.tile(random.uniform(lower, upper), (len(path), 1))
        q[:, joint] = path
        torque = np.abs(arm.inverse_dynamics(q, 0.0 * q, push, links))
        if np.all(torque <= permitted) and torque[:, joint].max() > largest.max():
            best, largest = q[0], torque[:, joint]
    if joint == 0:  # its load does not depend on its position
        return best, np.linspace(-1.0, 1.0, count)
    wanted = np.linspace(largest.min(), largest.max(), count)
    return best, np.unique(path[[int(np.argmin(np.abs(largest - w))) for w in wanted]])


def _swing(pose: Array, acceleration: float, fastest: float) -> tuple[Array, Array, Array, Array]:
    """Return a minute of sinusoidal motion of joint 1, whose load is its inertia."""
    omega = acceleration / fastest
    t = np.arange(0.0, 60.0, 1.0 / SWEEP_RATE)
    q = np.tile(pose, (len(t), 1))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    q[:, 0] += fastest / omega * np.sin(omega * t)
    dq[:, 0] = fastest * np.cos(omega * t)
    ddq[:, 0] = -acceleration * np.sin(omega * t)
    return t, q, dq, ddq
