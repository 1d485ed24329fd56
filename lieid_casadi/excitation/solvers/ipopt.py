"""Ipopt over a semi-infinite constraint set: exchange of rows outside, a dense Hessian inside.

Ipopt's constraints are the peaks of the limits on a fine time grid, about a hundred in place of
thousands. As soon as an iterate violates a limit that is not among them, the run stops, the new
peaks become rows, and the next run starts from this iterate, or from the one before it where the
violation is large. The Hessian is a damped BFGS approximation that is kept between runs and
stages; Ipopt's own limited-memory approximation restarts in every run. The barrier parameter
decreases from stage to stage, together with the smoothing of the criterion.

The exchange needs callbacks between the iterations, so the program consists of Python functions
rather than of one CasADi graph (see `nonlinear_program`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.limits.constraint_sets import ConstraintRows, SampledConstraints
from lieid_casadi.excitation.solvers.iterates import (
    Iterate,
    Iteration,
    Objective,
    evaluate_iterate,
    initial_hessian,
    update_hessian,
)
from lieid_casadi.excitation.solvers.nonlinear_program import run_ipopt

if TYPE_CHECKING:
    from scipy.optimize import BFGS

Array = NDArray[np.float64]
ROW_THRESHOLD = -0.3  # scaled excess above which a peak becomes a row
STOP_THRESHOLD = 5e-3  # scaled excess outside the rows that stops a run
CONTINUE_THRESHOLD = 2.5e-3  # scaled excess outside the rows that starts another run
DROP_THRESHOLD = -0.1  # scaled excess below which a row is dropped between runs
LARGE_INCREASE = 0.05  # of the scaled excess in one step, from which the step is rejected
RUN_RADIUS = 0.3  # largest change of a variable in one run; few limits are rows at its start
FIRST_BARRIER = 1e-2  # largest barrier parameter of the first stage
FIRST_BARRIER_RATIO = 100.0  # the same, relative to the stage's tolerance
BARRIER_DECREASE = 0.3  # factor from stage to stage
SMALL_GAIN = 0.1  # gain of an iteration, relative to the barrier parameter, that counts as none
LEAST_SLACK = 1e-2  # in the first guess of a new row's multiplier
FEASIBLE_STALL = 2  # iterations without gain that end a run inside the limits
INFEASIBLE_STALL = 10  # the same while a limit is violated
FUTILE_RUNS = 20  # runs without a smaller violation that end a stage


@dataclass(eq=False)
class Ipopt:
    """Solver whose Hessian and barrier parameter carry over from stage to stage.

    Parameters
    ----------
    constraints : SampledConstraints
        May be replaced between two calls.
    size : int
        Number of free variables m.
    report : callable
        Called with each `Iteration`; may raise to stop.
    barrier : float, optional
        Barrier parameter; chosen from the tolerance of the first stage if left out.
    hessian : BFGS, optional
        Approximation to begin with.
    stage : int
        Number of the next stage, from 0.
    """

    constraints: SampledConstraints
    size: int
    report: Callable[[Iteration], None] = lambda iteration: None
    barrier: float | None = None
    hessian: BFGS | None = None
    stage: int = 0

    def minimize(
        self, objective: Objective, z: Array, *, iterations: int, tolerance: float
    ) -> Array:
        """Return the last iterate z (m,) of one stage.

        No clock is read: the same start gives the same iterates on a busy machine.

        Parameters
        ----------
        objective : callable
        z : (m,)
            Start.
        iterations : int
            At most.
        tolerance : float
            Decrease of the objective below which the stage ends.
        """
        c = self.constraints
        state = evaluate_iterate(c, objective, z)
        rows, multipliers = c.peaks(state.excess, ROW_THRESHOLD), np.zeros(0)
        count, futile, least = 0, 0, np.inf
        if self.barrier is None:
            self.barrier = min(FIRST_BARRIER, FIRST_BARRIER_RATIO * tolerance)
        while True:
            run = IpoptRun(self, objective, rows, state, count, self.barrier, tolerance)
            multipliers = run.solve(multipliers, iterations - count)
            count += max(run.count, 1)
            missing = c.peaks(run.last.excess, CONTINUE_THRESHOLD).without(rows)
            at_radius = float(np.abs(run.state.z - state.z).max()) > 0.99 * RUN_RADIUS
            state = run.state
            violated = state.violation > STOP_THRESHOLD
            futile = futile + 1 if violated and state.violation > 0.99 * least else 0
            least = min(least, state.violation)
            ended = count >= iterations or futile >= FUTILE_RUNS
            if ended:
                break
            if len(missing):
                new = c.peaks(state.excess, ROW_THRESHOLD).joined(
                    c.peaks(run.last.excess, ROW_THRESHOLD)
                )
                kept = c.at(state.excess, rows) > DROP_THRESHOLD
                multipliers, rows = multipliers[kept], rows.chosen(kept).joined(new)
            elif not at_radius:
                if self.barrier <= tolerance or violated:
                    break
                self.barrier = max(BARRIER_DECREASE * self.barrier, tolerance)
        self.barrier = max(BARRIER_DECREASE * self.barrier, tolerance)
        self.stage += 1
        return state.z


class IpoptRun:
    """One run of Ipopt with fixed rows; a `NonlinearProgram`.

    Attributes
    ----------
    state : Iterate
        The last iterate from which another run may start.
    last : Iterate
        The last iterate.
    count : int
        Number of iterations.
    """

    def __init__(
        self,
        solver: Ipopt,
        objective: Objective,
        rows: ConstraintRows,
        state: Iterate,
        before: int,
        barrier: float,
        tolerance: float,
    ) -> None:
        self.solver, self.objective, self.rows = solver, objective, rows
        self.state = self.last = self._here = state
        self.count, self._before, self._stall = 0, before, 0
        self._barrier, self._enough = barrier, max(tolerance, SMALL_GAIN * barrier)
        sets = solver.constraints.sets
        self._nonlinear = np.array([not limits.linear for limits in sets])[rows.sets]
        self._fixed = solver.constraints.jacobian(state.motion, rows)
        self._slopes = state, np.vstack([self._fixed, state.outcome.slopes])
        further = len(state.outcome.excess)
        self.linear = not (self._nonlinear.any() or further)
        self.pattern = np.concatenate(
            [(self._fixed != 0.0) | self._nonlinear[:, None], np.ones((further, solver.size), bool)]
        )
        self._curved = state, self._slopes[1]

    def solve(self, multipliers: Array, iterations: int) -> Array:
        """Return the multipliers of all rows; ``multipliers`` are those of the first rows."""
        start, barrier = self.state, self._barrier
        new = barrier / np.maximum(-self._limits(start)[len(multipliers) :], LEAST_SLACK)
        return run_ipopt(
            self, start.z, np.append(multipliers, new), radius=RUN_RADIUS, barrier=barrier,
            iterations=iterations,
        )[: len(self.rows)]  # fmt: skip

    def value(self, z: Array) -> float:
        """See `NonlinearProgram`."""
        return self._at(z).outcome.value

    def gradient(self, z: Array) -> Array:
        """See `NonlinearProgram`."""
        return self._at(z).outcome.gradient

    def limits(self, z: Array) -> Array:
        """See `NonlinearProgram`."""
        return self._limits(self._at(z))

    def slopes(self, z: Array) -> Array:
        """See `NonlinearProgram`."""
        return self._slopes_at(self._at(z))

    def hessian(self, z: Array, multipliers: Array) -> Array:
        """See `NonlinearProgram`; updated by the step since the last call."""
        state, solver = self._at(z), self.solver
        before, slopes_before = self._curved
        if solver.hessian is None:
            solver.hessian = initial_hessian(state.outcome.gradient)
        if state is not before:
            slopes = self._slopes_at(state)
            change = state.outcome.gradient - before.outcome.gradient
            change = change + multipliers @ (slopes - slopes_before)
            update_hessian(solver.hessian, state.z - before.z, change)
            self._curved = state, slopes
        matrix: Array = solver.hessian.get_matrix()
        return matrix

    def done(self, z: Array) -> bool:
        """See `NonlinearProgram`: no more gain, or a violated limit that is not a row."""
        if self.count == 0 and np.array_equal(z, self.state.z):
            return False  # the start
        solver, before = self.solver, self.state
        state = self.last = self._at(z)
        solver.report(Iteration(solver.stage, self._before + self.count, state))
        self.count += 1
        c = solver.constraints
        not_a_row = len(c.peaks(state.excess, STOP_THRESHOLD).without(self.rows)) > 0
        if not_a_row and state.violation > max(before.violation, 0.0) + LARGE_INCREASE:
            return True
        self.state = state
        gain = abs(before.outcome.value - state.outcome.value)
        violated = state.violation > STOP_THRESHOLD
        if violated:
            gain += abs(before.violation - state.violation)
        self._stall = self._stall + 1 if gain < self._enough else 0
        ended = self._stall >= (INFEASIBLE_STALL if violated else FEASIBLE_STALL)
        return not_a_row or ended

    def _at(self, z: Array) -> Iterate:
        if not np.array_equal(self._here.z, z):
            self._here = evaluate_iterate(self.solver.constraints, self.objective, z.copy())
        return self._here

    def _limits(self, state: Iterate) -> Array:
        excess = self.solver.constraints.at(state.excess, self.rows)
        return np.concatenate([excess, state.outcome.excess])

    def _slopes_at(self, state: Iterate) -> Array:
        if self._slopes[0] is not state:
            slopes = self._fixed
            if self._nonlinear.any():
                slopes = slopes.copy()
                chosen = self.rows.chosen(self._nonlinear)
                slopes[self._nonlinear] = self.solver.constraints.jacobian(state.motion, chosen)
            self._slopes = state, np.vstack([slopes, state.outcome.slopes])
        return self._slopes[1]
