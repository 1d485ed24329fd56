"""Iterates of a search, and the approximation of its Hessian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.excitation.criteria.objective_value import ObjectiveValue
from lieid_casadi.excitation.limits.constraint_sets import SampledConstraints

if TYPE_CHECKING:
    from scipy.optimize import BFGS

Array = NDArray[np.float64]
Objective = Callable[[Array], ObjectiveValue]
SMALLEST_MOVE = 1e-14  # length of a move below which rounding would shape the Hessian
LEAST_CURVATURE = 1e-3  # of the first Hessian


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point z (m,) of the search with the objective, the motion and the limits there.

    Attributes
    ----------
    z : (m,)
        Free variables of the trajectory.
    outcome : ObjectiveValue
    motion : MotionSamples
        On the grid of the constraints.
    excess : list of pairs (k, N)
        Scaled excesses past the upper and lower limits, one pair per constraint set.
    violation : float
        Largest scaled excess; at most 0 where every limit holds with its margin.
    """

    z: Array
    outcome: ObjectiveValue
    motion: MotionSamples
    excess: list[tuple[Array, Array]]
    violation: float


@dataclass(frozen=True, eq=False)
class Iteration:
    """Progress of a search: the state after iteration ``number`` of stage ``stage``."""

    stage: int
    number: int
    state: Iterate


def evaluate_iterate(constraints: SampledConstraints, objective: Objective, z: Array) -> Iterate:
    """Evaluate objective and limits at z (m,).

    Parameters
    ----------
    constraints : SampledConstraints
    objective : Objective
    z : (m,)
        Coefficients of the trajectory.
    """
    outcome = objective(z)
    motion = constraints.sampled.motion(z)
    excess = constraints.excess(motion)
    violation = max(constraints.largest(excess), float(outcome.excess.max(initial=-1.0)))
    return Iterate(z, outcome, motion, excess, violation)


def initial_hessian(gradient: Array) -> BFGS:
    """Return a BFGS approximation with Powell's damping that begins at ‖gradient‖ · 1."""
    from scipy.optimize import BFGS

    hessian = BFGS(
        exception_strategy="damp_update",
        min_curvature=0.2,
        init_scale=max(LEAST_CURVATURE, float(np.linalg.norm(gradient))),
    )
    hessian.initialize(len(gradient), "hess")
    return hessian


def update_hessian(hessian: BFGS, move: Array, change: Array) -> None:
    """Update by the change (m,) of the Lagrangian's gradient along a move (m,).

    Parameters
    ----------
    hessian : BFGS
        Changed in place.
    move, change : (m,)
        Step, and change of the gradient along it.
    """
    if np.linalg.norm(move) > SMALLEST_MOVE and change.any():
        hessian.update(move, change)
