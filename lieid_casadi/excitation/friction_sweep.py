"""Constant-speed runs of one joint, forward and backward over the same positions (6.4.2).

Half the difference of the torques of both directions at a position is the friction (Eq. 15).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExcitationError, NoSolution
from lieid_casadi.excitation.checks import CONTROL_STEP, MARGIN, default_limits, verify
from lieid_casadi.excitation.design import RANGE_USED, find_start_pose, rest_pose
from lieid_casadi.excitation.limits import (
    ConstraintSet,
    JointLimits,
    Limit,
    MotionRange,
    motion_range,
    on_arm,
    sets_of,
)
from lieid_casadi.excitation.sample_functions import IdentifiedModel, model_and_fit
from lieid_casadi.excitation.trajectory import MotionSamples, csv_text
from lieid_casadi.model import Model
from lieid_casadi.robot import Robot

SPEEDS = np.deg2rad(
    [
        0.1, 0.2, 0.4, 0.5, 0.8, 1, 1.2, 1.5, 1.6, 1.8, 2, 2.2, 2.5, 2.8,
        3, 3.5, 4, 4.5, 5, 6, 8, 10, 12, 15, 16, 20, 25, 30,
    ]
)  # fmt: skip
DWELL = 0.5  # s at rest between runs
STEEPEST = 1.875  # slope of the quintic step at most
RAMP_MARGIN = 1.1  # on the shortest ramp that the acceleration limit permits
SHORTEST_RAMP = 0.2  # s
REACHES = (1.0, 0.7, 0.5, 0.35, 0.25)  # parts of the longest motion for which a pose is searched


@dataclass(frozen=True)
class ConstantSpeed:
    """A part at constant speed: signed speed in rad/s, from ``start`` to ``end`` in s."""

    speed: float
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class FrictionSweep:
    """Runs of one joint (from 0) while the others rest at the start pose.

    ``parts`` are the slowest first, forward and backward in turn; ``left_out`` are speeds beyond
    the joint's limit, or for which its range is too short, rad/s. ``checked`` and ``unchecked`` are
    those of `Excitation`.
    """

    model: Model
    joint: int
    motion: MotionSamples
    parts: tuple[ConstantSpeed, ...]
    left_out: tuple[float, ...]
    checked: tuple[str, ...]
    unchecked: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return a description of the runs; joints are numbered from 1."""
        return {
            "robot": self.model.robot.name,
            "joint": self.joint + 1,
            "duration": float(self.motion.t[-1]),
            "parts": [{"speed": p.speed, "start": p.start, "end": p.end} for p in self.parts],
            "left_out": list(self.left_out),
            "checked": list(self.checked),
            "unchecked": list(self.unchecked),
        }

    def files(self) -> dict[str, bytes]:
        """Return the content of ``friction_sweep_qJ.csv`` and ``.json`` by name."""
        name = f"friction_sweep_q{self.joint + 1}"
        table = csv_text(self.motion, self.checked, self.unchecked)
        content = json.dumps({"schema": 1} | self.to_dict(), indent=1)
        return {f"{name}.csv": table.encode(), f"{name}.json": content.encode()}


def friction_sweep(
    source: Model | Robot | IdentifiedModel,
    joint: int,
    *,
    speeds: ArrayLike = SPEEDS,
    seconds: float = 6.0,
    start_pose: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    margin: float = MARGIN,
    limits: Sequence[Limit] | None = None,
    rate: float = 200.0,
) -> FrictionSweep:
    """Return constant-speed runs of a joint (from 0) around the start pose.

    ``speeds`` (k,) are in rad/s, by default the paper's 28 from 0.1 to 30 °/s; ``seconds`` is the
    longest part at constant speed: slow runs cover a smaller part of the range. The default start
    pose is one around which the joint can move as far as the longest run needs or, where there is
    none, down to a quarter of it.
    """
    model, fit = model_and_fit(source)
    robot = model.robot
    if not 0 <= joint < robot.n:
        raise ExcitationError(f"friction sweep: no joint {joint + 1}; the arm has 1 to {robot.n}")
    if not (seconds > 0.0 and rate > 0.0):
        raise ExcitationError("friction sweep: seconds and rate must be positive")
    joints = motion_range(robot, acceleration, margin=margin)
    if limits is None:
        limits = default_limits(robot, margin=margin)
    made = on_arm(limits, robot, fit)
    sets = (*sets_of(made), JointLimits(joints))
    reach = min(RANGE_USED * joints.units[joint, 0], 0.5 * seconds * float(np.max(np.abs(speeds))))
    if start_pose is None:
        pose, reach = _found_pose(robot, joints, sets, joint, reach)
    else:
        pose = rest_pose(robot, joints, sets, start_pose)
    runs, left_out = _runs(joints, joint, pose[joint], np.sort(np.abs(speeds)), seconds, reach)
    if not runs:
        raise NoSolution(
            f"friction sweep: the range of joint {joint + 1} around {pose[joint]:g} is too short "
            "for every speed; choose a start pose nearer to the middle of the range"
        )
    acceleration_limit = float(joints.acceleration[joint])
    motion, parts = _motion(pose, joint, runs, rate, acceleration_limit)
    fine, _ = _motion(pose, joint, runs, 1.0 / CONTROL_STEP, acceleration_limit)
    verified = verify(robot, fine, joints, made, fit)
    return FrictionSweep(
        model, joint, motion, parts, tuple(left_out), verified.checked, verified.unchecked
    )


def _found_pose(
    robot: Robot, limits: MotionRange, sets: Sequence[ConstraintSet], joint: int, reach: float
) -> tuple[Array, float]:
    """Return a pose around which the joint can move, and how far it moves to either side, rad."""
    for part in REACHES:
        travel = np.zeros(robot.n)
        travel[joint] = part * reach
        try:
            return find_start_pose(robot, limits, sets, travel=travel), part * reach
        except NoSolution as failure:
            reason = failure
    raise NoSolution(f"friction sweep of joint {joint + 1}: {reason}")


@dataclass(frozen=True)
class _Run:
    """From rest to rest: a smooth ramp up to ``speed``, a steady part, a ramp down (s)."""

    speed: float
    ramp: float
    steady: float

    @property
    def travel(self) -> float:
        """Distance of the run, rad."""
        return self.speed * (self.steady + self.ramp)


def _runs(
    limits: MotionRange, joint: int, centre: float, speeds: Array, seconds: float, reach: float
) -> tuple[list[_Run], list[float]]:
    """Return the runs that fit the joint's range, and the speeds that are left out."""
    low, high = limits.position[joint]
    available = 2.0 * min(RANGE_USED * min(centre - low, high - centre), reach, np.pi)
    runs, left_out = [], []
    for speed in speeds.tolist():
        ramp = max(SHORTEST_RAMP, RAMP_MARGIN * STEEPEST * speed / limits.acceleration[joint])
        steady = min(seconds, available / speed - ramp)
        if speed > limits.velocity[joint] or steady < ramp:
            left_out.append(speed)
        else:
            runs.append(_Run(speed, ramp, steady))
    return runs, left_out


Phase = tuple[float, float, float]  # duration, s, and the speed before and after it, rad/s


def _motion(
    pose: Array, joint: int, runs: Sequence[_Run], rate: float, acceleration: float
) -> tuple[MotionSamples, tuple[ConstantSpeed, ...]]:
    """Compose the runs: to the start, forward, backward, to the next start."""
    phases, parts = list[Phase](), list[ConstantSpeed]()
    fastest = max(run.speed for run in runs)

    def go(target: float) -> None:
        distance = target - sum(0.5 * seconds * (a + b) for seconds, a, b in phases)
        shortest = np.sqrt(RAMP_MARGIN * STEEPEST * abs(distance) / acceleration)
        seconds = max(0.5, abs(distance) / fastest, float(shortest))
        phases.extend([(seconds, 0.0, distance / seconds), (seconds, distance / seconds, 0.0)])

    for run in runs:
        go(-0.5 * run.travel)
        for speed in (run.speed, -run.speed):
            phases.append((DWELL, 0.0, 0.0))
            begins = sum(seconds for seconds, _, _ in phases) + run.ramp
            parts.append(ConstantSpeed(speed, begins, begins + run.steady))
            phases += [(run.ramp, 0.0, speed), (run.steady, speed, speed), (run.ramp, speed, 0.0)]
    phases.append((DWELL, 0.0, 0.0))
    go(0.0)
    time, moved = _sampled(phases, rate)
    signals = np.zeros((3, len(time), len(pose)))
    signals[0] = pose
    signals[:, :, joint] += moved
    return MotionSamples(time, *signals), tuple(parts)


def _sampled(phases: Sequence[Phase], rate: float) -> tuple[Array, Array]:
    """Return times (N,), and distance, speed and acceleration (3, N) along phases."""
    times, motions, start, distance = [np.zeros(1)], [np.zeros((3, 1))], 0.0, 0.0
    for seconds, before, after in phases:
        count = max(2, round(seconds * rate))
        u, change = np.arange(1, count + 1) / count, after - before
        step = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        covered = u * before + u**4 * (2.5 - 3.0 * u + u**2) * change  # per second of the phase
        slope = 30.0 * u**2 * (1.0 - u) ** 2 / seconds
        times.append(start + seconds * u)
        motions.append(
            np.stack([distance + seconds * covered, before + change * step, change * slope])
        )
        start, distance = start + seconds, float(motions[-1][0, -1])
    return np.concatenate(times), np.concatenate(motions, axis=1)
