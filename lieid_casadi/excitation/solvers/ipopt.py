"""Ipopt over a semi-infinite constraint set: exchange around it, a dense Hessian inside it.

Ipopt gets the limits' peaks on a fine time grid as its rows, some hundred in place of thousands.
As soon as an iterate breaks a limit that is not among them, its peaks become rows and Ipopt goes
on from there, or from the iterate before where the breach is large. The Hessian is a damped BFGS
matrix of ours that outlives runs and stages; Ipopt's own limited-memory one forgets at each. The
barrier parameter falls from stage to stage, together with the smoothing of the criterion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.limits.constraint_sets import ConstraintRows, SampledConstraints
from lieid_casadi.excitation.solvers.nonlinear_program import run_ipopt
from lieid_casadi.excitation.solvers.quasi_newton import damped_bfgs, first_hessian
from lieid_casadi.excitation.solvers.solver_interface import (
    Iterate,
    Iteration,
    Objective,
    evaluate_iterate,
)

Array = NDArray[np.float64]
NEAR = -0.3  # scaled excess from which a peak is a row
OVERLOOKED = 5e-3  # scaled excess at which an iterate is stopped for rows it lacks
KEPT = 2.5e-3  # and from which a stage goes on with them
FAR = -0.1  # scaled excess below which a row is dropped between runs
LEAP = 0.05  # scaled excess gained in one step from which the step is taken back
REACH = 0.3  # of a run, per variable; near the start few limits are rows
BARRIER = 1e-2  # barrier parameter of the first stage at most
ABOVE = 100.0  # and in parts of its tolerance: early on, far from limits, it finds better optima
SMALLER = 0.3  # barrier parameter from stage to stage
SETTLED = 0.1  # gain of an iteration, in parts of the barrier parameter, that ends a run
SLACK = 1e-2  # least slack that a new row's multiplier is guessed from
STILL = 2  # iterations without gain that end a run
STUCK = 10  # the same where a limit is broken
HOPELESS = 20  # runs without a smaller breach that end a stage


@dataclass(eq=False)
class Ipopt:
    """The solver; its Hessian and barrier parameter carry over from stage to stage.

    Parameters
    ----------
    constraints : SampledConstraints
    report : callable
        Called with each `Iteration` and its z; may raise to stop.
    """

    constraints: SampledConstraints
    size: int
    report: Callable[[Iteration], None] = lambda iteration: None
    barrier: float | None = None
    hessian: Array | None = None
    stage: int = 0

    def minimize(
        self, objective: Objective, z: Array, *, iterations: int, tolerance: float
    ) -> Array:
        """Return the last iterate of one stage."""
        c = self.constraints
        state = evaluate_iterate(c, objective, z)
        rows, multipliers = c.peaks(state.excess, NEAR), np.zeros(0)
        count, in_vain, least = 0, 0, np.inf
        if self.barrier is None:
            self.barrier = min(BARRIER, ABOVE * tolerance)
        while True:
            run = IpoptRun(self, objective, rows, state, count, self.barrier, tolerance)
            multipliers = run.solve(multipliers, iterations - count)
            count += max(run.count, 1)
            lacking = c.peaks(run.last.excess, KEPT).without(rows)
            held = float(np.abs(run.state.z - state.z).max()) > 0.99 * REACH
            state = run.state
            outside = state.violation > OVERLOOKED
            in_vain = in_vain + 1 if outside and state.violation > 0.99 * least else 0
            least = min(least, state.violation)
            ended = count >= iterations or in_vain >= HOPELESS
            if ended:
                break
            if len(lacking):
                found = c.peaks(state.excess, NEAR).joined(c.peaks(run.last.excess, NEAR))
                kept = c.at(state.excess, rows) > FAR
                multipliers, rows = multipliers[kept], rows.chosen(kept).joined(found)
            elif not held:
                if self.barrier <= tolerance or outside:
                    break
                self.barrier = max(SMALLER * self.barrier, tolerance)
        self.barrier = max(SMALLER * self.barrier, tolerance)
        self.stage += 1
        return state.z


class IpoptRun:
    """One run of Ipopt, with fixed rows; a `Program`.

    Attributes
    ----------
    state : Iterate
        The last iterate worth going on from.
    last : Iterate
        The last iterate.
    count : int
        Iterations made.
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
        self.count, self._before, self._still = 0, before, 0
        self._barrier, self._enough = barrier, max(tolerance, SETTLED * barrier)
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
        """Return the multipliers; ``multipliers`` are those of the first rows."""
        start, barrier = self.state, self._barrier
        new = barrier / np.maximum(-self._limits(start)[len(multipliers) :], SLACK)
        return run_ipopt(
            self, start.z, np.append(multipliers, new), reach=REACH, barrier=barrier,
            iterations=iterations,
        )[: len(self.rows)]  # fmt: skip

    def value(self, z: Array) -> float:
        """See `Program`."""
        return self._at(z).outcome.value

    def gradient(self, z: Array) -> Array:
        """See `Program`."""
        return self._at(z).outcome.gradient

    def limits(self, z: Array) -> Array:
        """See `Program`."""
        return self._limits(self._at(z))

    def slopes(self, z: Array) -> Array:
        """See `Program`."""
        return self._slopes_at(self._at(z))

    def hessian(self, z: Array, multipliers: Array) -> Array:
        """See `Program`; updated by the move since the last call."""
        state, solver = self._at(z), self.solver
        before, slopes_before = self._curved
        if solver.hessian is None:
            solver.hessian = first_hessian(state.outcome.gradient)
        if state is not before:
            slopes = self._slopes_at(state)
            change = state.outcome.gradient - before.outcome.gradient
            change = change + multipliers @ (slopes - slopes_before)
            solver.hessian = damped_bfgs(solver.hessian, state.z - before.z, change)
            self._curved = state, slopes
        return solver.hessian

    def done(self, z: Array) -> bool:
        """See `Program`: no gain, or a limit overlooked."""
        if self.count == 0 and np.array_equal(z, self.state.z):
            return False  # the start
        solver, before = self.solver, self.state
        state = self.last = self._at(z)
        solver.report(Iteration(solver.stage, self._before + self.count, state))
        self.count += 1
        c = solver.constraints
        overlooked = len(c.peaks(state.excess, OVERLOOKED).without(self.rows)) > 0
        if overlooked and state.violation > max(before.violation, 0.0) + LEAP:
            return True
        self.state = state
        gain = abs(before.outcome.value - state.outcome.value)
        outside = state.violation > OVERLOOKED
        if outside:
            gain += abs(before.violation - state.violation)
        self._still = self._still + 1 if gain < self._enough else 0
        ended = self._still >= (STUCK if outside else STILL)
        return overlooked or ended

    def _at(self, z: Array) -> Iterate:
        if not np.array_equal(self._here.z, z):
            self._here = evaluate_iterate(self.solver.constraints, self.objective, z.copy())
        return self._here

    def _limits(self, state: Iterate) -> Array:
        mine = self.solver.constraints.at(state.excess, self.rows)
        return np.concatenate([mine, state.outcome.excess])

    def _slopes_at(self, state: Iterate) -> Array:
        if self._slopes[0] is not state:
            slopes = self._fixed
            if self._nonlinear.any():
                slopes = slopes.copy()
                chosen = self.rows.chosen(self._nonlinear)
                slopes[self._nonlinear] = self.solver.constraints.jacobian(state.motion, chosen)
            self._slopes = state, np.vstack([slopes, state.outcome.slopes])
        return self._slopes[1]
