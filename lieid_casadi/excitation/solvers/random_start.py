"""Random starts of a search."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.design_problem import ExcitationProblem

Array = NDArray[np.float64]
USED = 0.9  # part of a joint limit that every joint of a start uses
LARGE_EXCESS = 0.3  # scaled excess above which a start is made smaller
SHRINK = 0.75
SHRINK_ROUNDS = 6


def random_start(problem: ExcitationProblem, seed: int) -> Array:
    """Return free variables (m,) that use 90 % of some joint limit of every joint.

    Where that violates other limits by much, all joints move less.
    """
    parametrization = problem.parametrization
    generator = np.random.default_rng(seed)
    z = generator.normal(size=(parametrization.n, parametrization.directions_per_joint))
    motion = problem.samples.motion(z.ravel())
    units, position = problem.design.range.units, problem.design.range.position
    from_pose = np.abs(motion.q - parametrization.pose)
    reach = np.minimum(position[:, 1] - parametrization.pose, parametrization.pose - position[:, 0])
    reach = np.where(np.isfinite(reach), reach, units[:, 0])
    used = np.stack(
        [
            from_pose.max(axis=0) / reach,
            np.abs(motion.dq).max(axis=0) / units[:, 1],
            np.abs(motion.ddq).max(axis=0) / units[:, 2],
        ]
    ).max(axis=0)
    start = np.ravel(USED * z / used[:, None])
    constraints = problem.constraints(1)
    for _ in range(SHRINK_ROUNDS):
        excess = constraints.excess(constraints.sampled.motion(start))
        if constraints.largest(excess) <= LARGE_EXCESS:
            break
        start = SHRINK * start
    return start
