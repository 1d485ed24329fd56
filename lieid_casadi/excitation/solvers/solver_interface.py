"""What a solver of excitation problems is: objective, iterates, and one method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.excitation.criteria.objective_value import ObjectiveValue
from lieid_casadi.excitation.limits.constraint_sets import SampledConstraints

Array = NDArray[np.float64]


Objective = Callable[[Array], ObjectiveValue]


@dataclass(frozen=True, eq=False)
class Iterate:
    """An iterate: everything known at z."""

    z: Array
    outcome: ObjectiveValue
    motion: MotionSamples
    excess: list[tuple[Array, Array]]
    violation: float


@dataclass(frozen=True, eq=False)
class Iteration:
    """What progress shows: the state after iteration ``number`` of stage ``stage``."""

    stage: int
    number: int
    state: Iterate


class Solver(Protocol):
    """Minimizes one objective after the other; what it learned of one serves the next.

    Every solver is made with ``constraints``, ``size`` (of z) and ``report`` (called with each
    `Iteration`; may raise to stop). No solver looks at a clock: the same start gives the same
    iterates on a busy machine.

    Attributes
    ----------
    constraints : SampledConstraints
        May be replaced between two calls.
    """

    constraints: SampledConstraints

    def minimize(
        self, objective: Objective, z: Array, *, iterations: int, tolerance: float
    ) -> Array:
        """Return the last iterate z (m,) of one stage.

        ``tolerance`` is the decrease of the objective below which the stage is done.
        """


def evaluate_iterate(constraints: SampledConstraints, objective: Objective, z: Array) -> Iterate:
    """Evaluate objective and limits at z (m,)."""
    outcome = objective(z)
    motion = constraints.sampled.motion(z)
    excess = constraints.excess(motion)
    violation = max(constraints.largest(excess), float(outcome.excess.max(initial=-1.0)))
    return Iterate(z, outcome, motion, excess, violation)
