"""The pose at which a trajectory starts: given, or found within all limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.excitation.limits.constraint_sets import ConstraintSet
from lieid_casadi.excitation.limits.joint_limits import MotionRange

Array = NDArray[np.float64]
TRIED = 2000  # random poses
RANGE_USED = 0.9  # part of the joint ranges that a motion around the pose uses
RANGE_TRIED = 0.6  # part of the joint ranges around their middle
ENOUGH = 0.05  # scaled distance from every limit above which the middle of the ranges is taken


def check_at_rest(pose: Array, sets: Sequence[ConstraintSet]) -> None:
    """Refuse a start pose (n,) that violates a limit at rest.

    Raises
    ------
    NoSolution
        Names the limit.
    """
    excess, names = _excess(pose[None], sets)
    worst = int(np.argmax(excess[:, 0]))
    if excess[worst, 0] > 0.0:
        raise NoSolution(
            f"the start pose violates a limit at rest: {names[worst]}; choose another start pose "
            "(--start-pose) or relax the limit"
        )


def find_start_pose(
    limits: MotionRange, sets: Sequence[ConstraintSet], *, travel: Array | None = None
) -> Array:
    """Return the middle of the joint ranges or, near a limit, the random pose farthest from all.

    Parameters
    ----------
    limits : MotionRange
    sets : sequence of ConstraintSet
        Evaluated at rest.
    travel : (n,), optional
        Distance that each joint will move to either side of the pose, rad.

    Raises
    ------
    NoSolution
        No pose meets all limits; names the one that the best pose violates.
    """
    half = RANGE_TRIED * limits.units[:, 0]
    if travel is not None:
        space = np.maximum(limits.units[:, 0] - travel / RANGE_USED, 0.0)
        half = np.where(travel > 0.0, space, half)
    random = np.random.default_rng(0).uniform(-half, half, (TRIED, len(half)))
    poses = limits.middle + np.vstack([np.zeros(len(half)), random])
    excess, names = _excess(poses, sets)
    if travel is not None:
        for part in (-1.0, -0.5, 0.5, 1.0):
            excess = np.maximum(excess, _excess(poses + part * travel, sets)[0])
    largest = excess.max(axis=0)
    best = 0 if largest[0] <= -ENOUGH else int(np.argmin(largest))
    if largest[best] > 0.0:
        raise NoSolution(
            f"no start pose of {TRIED} meets all limits: {names[int(np.argmax(excess[:, best]))]} "
            "is violated; relax it, or give a start pose (--start-pose)"
        )
    return np.asarray(poses[best])


def _excess(poses: Array, sets: Sequence[ConstraintSet]) -> tuple[Array, list[str]]:
    """Return scaled excesses (k, N) at rest in poses (N, n), and the names of the quantities."""
    rest = np.zeros_like(poses)
    motion = MotionSamples(np.zeros(len(poses)), poses, rest, rest, rest)
    parts = [s.excess(s.values(motion)) / s.scale[:, None] for s in sets]
    return np.concatenate(parts), [label for s in sets for label in s.labels]
