"""Sequential quadratic programming over a semi-infinite constraint set.

Each iteration takes the peaks of the limits on a fine time grid as rows, solves a small dense
quadratic program with a damped BFGS Hessian, adds rows where the step would violate another limit,
and searches along the step on the exact penalty function f + ρ·max excess (Fletcher's Sl∞QP).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.limits.constraint_sets import ConstraintRows, SampledConstraints
from lieid_casadi.excitation.solvers import quadratic_program
from lieid_casadi.excitation.solvers.quadratic_program import QuadraticSolution
from lieid_casadi.excitation.solvers.solver_interface import (
    Iterate,
    Iteration,
    Objective,
    evaluate_iterate,
    initial_hessian,
    update_hessian,
)

if TYPE_CHECKING:
    from scipy.optimize import BFGS

Array = NDArray[np.float64]
ROW_THRESHOLD = -0.3  # scaled excess above which a peak becomes a row
ROW_ROUNDS = 5  # how often rows are added to one quadratic program
NEW_ROW_THRESHOLD = 2e-3  # scaled excess after a step above which a peak becomes a row
LONGEST_STEP = 1.0  # per variable
SHORTEST_FRACTION = 1e-3  # smallest fraction of a step that is tried


@dataclass(eq=False)
class Sqp:
    """Solver whose Hessian and penalty carry over from stage to stage.

    Parameters
    ----------
    constraints : SampledConstraints
    size : int
        Number of free variables m.
    report : callable
        Called with each `Iteration`; may raise to stop.
    penalty : float
        ρ, increased as needed.
    hessian : BFGS, optional
        Approximation to begin with.
    stage : int
        Number of the next stage, from 0.
    """

    constraints: SampledConstraints
    size: int
    report: Callable[[Iteration], None] = lambda iteration: None
    penalty: float = 1.0
    hessian: BFGS | None = None
    stage: int = 0

    def minimize(
        self, objective: Objective, z: Array, *, iterations: int, tolerance: float
    ) -> Array:
        """See `solver_interface.Solver.minimize`."""
        state = self._state(objective, z)
        stall = 0
        for k in range(iterations):
            rows, step, slack = self._direction(state)
            self._raise_penalty(step, state.violation, slack)
            predicted = -float(state.outcome.gradient @ step.step) + self.penalty * (
                max(state.violation, 0.0) - slack
            )
            after = self._search(objective, state, step, rows, predicted)
            self._update_hessian(state, after, rows, step.multipliers)
            gain = self._merit(state) - self._merit(after)
            state = after
            self.report(Iteration(self.stage, k, state))
            stall = stall + 1 if gain < tolerance else 0
            if stall >= 2:
                break
        self.stage += 1
        return state.z

    def _state(self, objective: Objective, z: Array) -> Iterate:
        return evaluate_iterate(self.constraints, objective, z)

    def _merit(self, state: Iterate) -> float:
        return state.outcome.value + self.penalty * max(state.violation, 0.0)

    def _direction(self, state: Iterate) -> tuple[ConstraintRows, QuadraticSolution, float]:
        """Return the rows, the step and the excess after it in the quadratic program."""
        c = self.constraints
        rows = c.peaks(state.excess, ROW_THRESHOLD)
        matrix, values = c.jacobian(state.motion, rows), c.at(state.excess, rows)
        for last in [False] * (ROW_ROUNDS - 1) + [True]:
            step, slack = self._solve(state, matrix, values, state.outcome.excess)
            ahead = c.excess(c.sampled.motion(state.z + step.step))
            new = c.peaks(ahead, max(slack, 0.0) + NEW_ROW_THRESHOLD).without(rows)
            if last or not len(new):
                break
            rows = rows.joined(new)
            matrix = np.vstack([matrix, c.jacobian(state.motion, new)])
            values = np.concatenate([values, c.at(state.excess, new)])
        return rows, step, slack

    def _solve(
        self, state: Iterate, matrix: Array, values: Array, further: Array
    ) -> tuple[QuadraticSolution, float]:
        """Return the step, multipliers of the given rows first, and the excess after it."""
        gradient = state.outcome.gradient
        if self.hessian is None:
            self.hessian = initial_hessian(gradient)
        matrix = np.vstack([matrix, state.outcome.slopes])
        values = np.concatenate([values, further])
        worst = max(float(values.max(initial=0.0)), 0.0)
        if worst <= 1e-9:
            step = quadratic_program.solve(
                self.hessian.get_matrix(), gradient, matrix, np.maximum(-values, 0.0)
            )
            if step is not None:
                return _shortened(step), 0.0
        return self._elastic(self.hessian, gradient, matrix, values, worst)

    def _elastic(
        self, approximation: BFGS, gradient: Array, matrix: Array, values: Array, worst: float
    ) -> tuple[QuadraticSolution, float]:
        """Return the step of the program whose rows may be exceeded at the cost of the penalty."""
        hessian = np.zeros((self.size + 1, self.size + 1))
        hessian[:-1, :-1] = approximation.get_matrix()
        hessian[-1, -1] = self.penalty  # a small curvature of the slack, in its own scale
        elastic = np.zeros((len(matrix) + 1, self.size + 1))
        elastic[:-1, :-1], elastic[:, -1] = matrix, -1.0
        step = quadratic_program.solve(
            hessian, np.append(gradient, self.penalty), elastic, np.append(-values, 0.0)
        )
        if step is None:
            self.hessian = None
            return QuadraticSolution(np.zeros(self.size), np.zeros(len(values))), worst
        slack = max(float(step.step[-1]), 0.0)
        return _shortened(QuadraticSolution(step.step[:-1], step.multipliers[:-1])), slack

    def _raise_penalty(self, step: QuadraticSolution, violation: float, slack: float) -> None:
        needed = 1.5 * float(step.multipliers.sum())
        if slack > 0.5 * violation > 1e-9:
            needed = max(needed, 4.0 * self.penalty)
        if needed > self.penalty:
            self.penalty = min(needed, 1e5)

    def _search(
        self,
        objective: Objective,
        state: Iterate,
        step: QuadraticSolution,
        rows: ConstraintRows,
        predicted: float,
    ) -> Iterate:
        """Return the state after the step, shortened until the penalty function falls."""
        start, length = self._merit(state), 1.0
        direction = step.step
        while True:
            after = self._state(objective, state.z + length * direction)
            gained = start - self._merit(after)
            if gained >= 1e-4 * length * predicted:
                return after
            if length < SHORTEST_FRACTION:  # the quadratic model is wrong: discard its curvature
                self.hessian = None
                return state
            if length == 1.0 and after.violation > max(state.violation, 0.0):
                corrected = self._corrected(state, after, step, rows)
                if corrected is not None:
                    second = self._state(objective, state.z + corrected)
                    if start - self._merit(second) >= 1e-4 * predicted:
                        return second
            curvature = length * predicted - gained
            length *= min(0.5, max(0.1, 0.5 * length * predicted / max(curvature, 1e-300)))

    def _corrected(
        self, state: Iterate, after: Iterate, step: QuadraticSolution, rows: ConstraintRows
    ) -> Array | None:
        """Return the step corrected for the curvature of the limits (second-order correction)."""
        c = self.constraints
        every = rows.joined(c.peaks(after.excess, 0.0))
        matrix = c.jacobian(state.motion, every)
        values = c.at(after.excess, every) - matrix @ step.step
        further = after.outcome.excess - state.outcome.slopes @ step.step
        again, slack = self._solve(state, matrix, values, further)
        return again.step if slack < after.violation else None

    def _update_hessian(
        self, before: Iterate, after: Iterate, rows: ConstraintRows, multipliers: Array
    ) -> None:
        """Damped BFGS (Powell) on the Lagrangian."""
        if self.hessian is None:
            return
        move = after.z - before.z
        change = after.outcome.gradient - before.outcome.gradient
        nonlinear = np.array([not limits.linear for limits in self.constraints.sets])
        active = (multipliers[: len(rows)] > 1e-8) & nonlinear[rows.sets]
        further = multipliers[len(rows) :]
        change = change + further @ (after.outcome.slopes - before.outcome.slopes)
        if active.any():
            chosen = rows.chosen(active)
            jacobian = self.constraints.jacobian
            slopes = jacobian(after.motion, chosen) - jacobian(before.motion, chosen)
            change = change + multipliers[: len(rows)][active] @ slopes
        update_hessian(self.hessian, move, change)


def _shortened(step: QuadraticSolution) -> QuadraticSolution:
    """Return the step, shortened to the longest allowed."""
    longest = float(np.abs(step.step).max(initial=0.0))
    if longest <= LONGEST_STEP:
        return step
    return QuadraticSolution(step.step * (LONGEST_STEP / longest), step.multipliers)
