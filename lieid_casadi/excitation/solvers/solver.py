"""What a solver of excitation problems is: objective, iterates, and one method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.basis.trajectory import Motion
from lieid_casadi.excitation.limits.constraint_sets import SampledConstraints

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Outcome:
    """An objective at z: value, gradient (m,), G (p, p) and further limits excess ≤ 0.

    ``excess`` (s,) has the slopes (s, m); most objectives have none.
    """

    value: float
    gradient: Array
    gram: Array
    excess: Array
    slopes: Array


Objective = Callable[[Array], Outcome]


@dataclass(frozen=True, eq=False)
class State:
    """An iterate: everything known at z."""

    z: Array
    outcome: Outcome
    motion: Motion
    excess: list[tuple[Array, Array]]
    violation: float


@dataclass(frozen=True, eq=False)
class Iteration:
    """What progress shows: the state after iteration ``number`` of stage ``stage``."""

    stage: int
    number: int
    state: State


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


def state_at(constraints: SampledConstraints, objective: Objective, z: Array) -> State:
    """Evaluate objective and limits at z (m,)."""
    outcome = objective(z)
    motion = constraints.sampled.motion(z)
    excess = constraints.excess(motion)
    violation = max(constraints.largest(excess), float(outcome.excess.max(initial=-1.0)))
    return State(z, outcome, motion, excess, violation)
