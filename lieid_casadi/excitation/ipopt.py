"""Ipopt over a semi-infinite constraint set: exchange of rows outside, a dense Hessian inside.

Ipopt's constraints are the peaks of the limits on a fine time grid, about a hundred in place of
thousands. As soon as an iterate violates a limit that is not among them, the run stops, the new
peaks become rows, and the next run starts from this iterate, or from the one before it where the
violation is large. The Hessian is a damped BFGS approximation that is kept between runs and
stages; Ipopt's own limited-memory approximation restarts in every run. The barrier parameter
decreases from stage to stage, together with the smoothing of the criterion.

The exchange needs callbacks between the iterations, and CasADi does not differentiate the
eigenvalues of a criterion, so the program consists of Python functions rather than of a graph.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.excitation.limits import ConstraintSet
from lieid_casadi.excitation.trajectory import MotionSamples, SampledBasis

if TYPE_CHECKING:
    from scipy.optimize import BFGS

Values = Sequence[float | Array]
NEAR = -0.3  # scaled excess above which a peak becomes a row
FAR = -0.1  # scaled excess below which a row is dropped between runs
VIOLATED = 5e-3  # scaled excess that counts; half of it outside the rows starts another run
JUMP = 0.05  # increase of the scaled excess from which a step is taken back
RADIUS = 0.3  # largest change of a variable in one run; few limits are rows at its start
DECREASE = 0.3  # of the barrier parameter from stage to stage
FUTILE = 20  # runs without a smaller violation that end a stage
STALLED, STALLED_OUTSIDE = 2, 10  # iterations without gain that end a run
PUSH = 1e-4  # distance from their bound of slacks that start on it


@dataclass(frozen=True, eq=False)
class ObjectiveValue:
    """An objective at z: value, gradient (m,), G (p, p) and further limits excess ≤ 0."""

    value: float
    gradient: Array
    gram: Array
    excess: Array  # (s,) most objectives have none
    slopes: Array  # (s, m)


Objective = Callable[[Array], ObjectiveValue]


@dataclass(frozen=True, eq=False)
class SampledConstraints:
    """Constraint sets on a grid of times, as scaled excesses of the free variables z.

    The excess (k, N) of every upper and every lower limit, set after set, is the distance beyond
    it in parts of its scale, plus ``margin``: a motion with nonpositive excess keeps the margin
    from every limit. A row is the index of a limit at a sample in the flat excess.
    """

    sets: tuple[ConstraintSet, ...]
    sampled: SampledBasis
    margin: float

    def excess(self, motion: MotionSamples) -> Array:
        """Return the scaled excesses (k, N)."""
        parts = []
        for limits in self.sets:
            values, scale = limits.values(motion), limits.scale[:, None]
            above, below = values - limits.upper[:, None], limits.lower[:, None] - values
            parts += [above / scale, below / scale]
        return np.concatenate(parts) + self.margin

    def peaks(self, excess: Array, threshold: float) -> Indices:
        """Return the rows of the local maxima over time above a threshold."""
        before, after = np.roll(excess, 1, axis=1), np.roll(excess, -1, axis=1)
        return np.flatnonzero((excess > threshold) & (excess >= before) & (excess > after))

    def nonlinear(self, rows: Indices) -> Mask:
        """Return which rows are of sets that are not linear in z."""
        of_limits = np.repeat(
            [not s.linear for s in self.sets], [2 * len(s.scale) for s in self.sets]
        )
        return np.asarray(of_limits[rows // len(self.sampled.t)])

    def jacobian(self, motion: MotionSamples, rows: Indices) -> Array:
        """Return ∂excess/∂z (R, n d) of rows."""
        functions = self.sampled.functions  # (n, 3, N, d)
        n, _, count, d = functions.shape
        limit, sample = np.divmod(rows, count)
        result = np.zeros((len(rows), n, d))
        for limits in self.sets:
            below, quantity = np.divmod(limit, len(limits.scale))
            own = np.flatnonzero((below == 0) | (below == 1))
            limit = limit - 2 * len(limits.scale)
            if not len(own):
                continue
            below, quantity = below[own], quantity[own]
            samples, place = np.unique(sample[own], return_inverse=True)
            slopes = limits.jacobian(motion.at(samples))
            factor = (1 - 2 * below) / limits.scale[quantity]
            slopes = (slopes[quantity, :, place] * factor[:, None]).reshape(-1, 3, n)
            result[own] = np.einsum(
                "rkj,jkrd->rjd", slopes, functions[:, :, sample[own], :], optimize=True
            )
        return result.reshape(len(rows), n * d)


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point z (m,) of the search with the objective, the motion and the limits there."""

    z: Array
    outcome: ObjectiveValue
    motion: MotionSamples
    excess: Array  # (k, N) scaled

    @classmethod
    def at(cls, constraints: SampledConstraints, objective: Objective, z: Array) -> Iterate:
        """Evaluate objective and limits at z (m,)."""
        motion = constraints.sampled.motion(z)
        return cls(z, objective(z), motion, constraints.excess(motion))

    @cached_property
    def violation(self) -> float:
        """Largest scaled excess."""
        return max(float(self.excess.max()), float(self.outcome.excess.max(initial=-1.0)))


@dataclass(eq=False)
class Ipopt:
    """Solver whose Hessian and barrier parameter carry over from stage to stage.

    ``report`` is called with the stage's number, the iteration's number in it and the iterate, and
    may raise to stop. The constraints may be replaced between two calls of `minimize`.
    """

    constraints: SampledConstraints
    report: Callable[[int, int, Iterate], None] = lambda stage, number, state: None
    barrier: float | None = None
    hessian: BFGS | None = None
    stage: int = 0

    def minimize(
        self, objective: Objective, z: Array, *, iterations: int, tolerance: float
    ) -> Array:
        """Return the last iterate z (m,) of one stage: of at most so many iterations.

        Runs of Ipopt follow each other. After each, rows that are far from their limit are
        dropped and the new peaks become rows. Where there are none and the run ended by itself,
        the barrier parameter decreases, down to the tolerance of the objective. The stage ends
        there, or where runs no longer reduce a violation. No clock is read: the same start gives
        the same iterates on a busy machine.
        """
        c = self.constraints
        state = Iterate.at(c, objective, z)
        rows, multipliers = c.peaks(state.excess, NEAR), np.zeros(0)
        count, futile, least = 0, 0, np.inf
        barrier = self.barrier or min(1e-2, 100.0 * tolerance)
        while True:
            run = _Run(self, objective, rows, state, count, max(tolerance, 0.1 * barrier))
            inside = np.maximum(-run.limits(state.z)[len(multipliers) :], 1e-2)
            multipliers = run.solve(
                np.append(multipliers, barrier / inside), barrier, iterations - count
            )[: len(rows)]
            count += max(run.count, 1)
            at_radius = float(np.abs(run.state.z - state.z).max()) > 0.99 * RADIUS
            state = run.state
            violated = state.violation > VIOLATED
            futile = futile + 1 if violated and state.violation > 0.99 * least else 0
            least = min(least, state.violation)
            if count >= iterations or futile >= FUTILE:
                break
            if len(np.setdiff1d(c.peaks(run.last.excess, 0.5 * VIOLATED), rows)):
                kept = state.excess.ravel()[rows] > FAR
                multipliers, rows = multipliers[kept], rows[kept]
                for excess in (state.excess, run.last.excess):
                    rows = np.append(rows, np.setdiff1d(c.peaks(excess, NEAR), rows))
            elif not at_radius:
                if barrier <= tolerance or violated:
                    break
                barrier = max(DECREASE * barrier, tolerance)
        self.barrier = max(DECREASE * barrier, tolerance)
        self.stage += 1
        return state.z


class _Run:
    """One run of Ipopt with fixed rows: min f(z) with g(z) ≤ 0, as functions of z (m,).

    ``last`` is the last iterate, ``state`` the last one from which another run may start,
    ``count`` the number of iterations.
    """

    def __init__(
        self, solver: Ipopt, objective: Objective, rows: Indices, state: Iterate, before: int,
        enough: float,
    ) -> None:  # fmt: skip
        self.solver, self.objective, self.rows = solver, objective, rows
        self.state = self.last = self._here = state
        self.count, self._before, self._enough, self._stall = 0, before, enough, 0
        self._slopes = state, self._slopes_of(state)
        self._curved = self._slopes
        self._failures: list[BaseException] = []

    def at(self, z: Array) -> Iterate:
        """Return the iterate at z, evaluated once."""
        if not np.array_equal(self._here.z, z):
            self._here = Iterate.at(self.solver.constraints, self.objective, z.copy())
        return self._here

    def limits(self, z: Array) -> Array:
        """Return g (R,)."""
        state = self.at(z)
        return np.append(state.excess.ravel()[self.rows], state.outcome.excess)

    def slopes(self, z: Array) -> Array:
        """Return ∂g/∂z (R, m)."""
        state = self.at(z)
        if self._slopes[0] is not state:
            self._slopes = state, self._slopes_of(state)
        return self._slopes[1]

    def _slopes_of(self, state: Iterate) -> Array:
        own = self.solver.constraints.jacobian(state.motion, self.rows)
        return np.vstack([own, state.outcome.slopes])

    def hessian(self, z: Array, multipliers: Array) -> Array:
        """Return an approximation of the Lagrangian's Hessian (m, m), updated by the last step."""
        state, solver = self.at(z), self.solver
        before, slopes_before = self._curved
        if solver.hessian is None:
            solver.hessian = _first_hessian(state.outcome.gradient)
        if state is not before:
            slopes, move = self.slopes(z), state.z - before.z
            change = state.outcome.gradient - before.outcome.gradient
            change = change + multipliers @ (slopes - slopes_before)
            # rounding would shape the Hessian
            if np.linalg.norm(move) > 1e-14 and change.any():
                solver.hessian.update(move, change)
            self._curved = state, slopes
        matrix: Array = solver.hessian.get_matrix()
        return matrix

    def done(self, z: Array) -> bool:
        """Record an iterate, the start first; return whether to stop there."""
        if self.count == 0 and np.array_equal(z, self.state.z):
            return False
        solver, before = self.solver, self.state
        state = self.last = self.at(z)
        solver.report(solver.stage, self._before + self.count, state)
        self.count += 1
        beyond = solver.constraints.peaks(state.excess, VIOLATED)
        not_a_row = len(np.setdiff1d(beyond, self.rows)) > 0
        if not_a_row and state.violation > max(before.violation, 0.0) + JUMP:
            return True
        self.state = state
        gain = abs(before.outcome.value - state.outcome.value)
        violated = state.violation > VIOLATED
        if violated:
            gain += abs(before.violation - state.violation)
        self._stall = self._stall + 1 if gain < self._enough else 0
        return not_a_row or self._stall >= (STALLED_OUTSIDE if violated else STALLED)

    def solve(self, multipliers: Array, barrier: float, iterations: int) -> Array:
        """Run Ipopt from the state with multipliers (R,), and return those at the end.

        No variable changes by more than the radius. The barrier parameter is constant, so that the
        run ends on the central path. Exceptions of the functions, KeyboardInterrupt included, are
        raised after Ipopt has ended.
        """
        z = self.state.z
        x = ca.MX.sym("z", len(z))
        settings = {
            "print_level": 0, "sb": "yes", "max_iter": iterations,
            "tol": 1e-6,  # the callback stops earlier
            "nlp_scaling_method": "none", "mu_strategy": "monotone", "mu_init": barrier,
            "mu_target": barrier, "warm_start_init_point": "yes",
            "warm_start_slack_bound_push": PUSH, "warm_start_slack_bound_frac": PUSH,
            "warm_start_bound_push": PUSH, "warm_start_bound_frac": PUSH,
            "warm_start_mult_bound_push": 1e-9, "acceptable_iter": 0,
        }  # fmt: skip
        try:
            # CasADi keeps no reference to the Python objects: keep them as long as the solver
            functions = self._functions(len(z))
            given = ("grad_f", "jac_g", "hess_lag", "iteration_callback")
            options: dict[str, Any] = {name: functions[name] for name in given} | {
                "no_nlp_grad": True, "print_time": False, "show_eval_warnings": False,
                "error_on_fail": False, "ipopt": settings,
            }  # fmt: skip
            nlp = {"x": x, "f": functions["f"](x), "g": functions["g"](x)}
            solver = ca.nlpsol("excitation", "ipopt", nlp, options)
            result = solver(
                x0=z, lbx=z - RADIUS, ubx=z + RADIUS, lbg=-np.inf, ubg=0.0, lam_g0=multipliers
            )
        except RuntimeError as error:
            # KeyboardInterrupt while CasADi asks a function for its shapes
            if "KeyboardInterrupt" in str(error):
                raise KeyboardInterrupt from error
            raise
        if self._failures:
            raise self._failures[0]
        return np.asarray(result["lam_g"].full().ravel())

    def _functions(self, size: int) -> dict[str, _Function]:
        """Return the functions under CasADi's names, with CasADi's signatures."""
        pattern = self._slopes[1] != 0.0  # entries of ∂g/∂z that can be nonzero
        pattern[: len(self.rows)] |= self.solver.constraints.nonlinear(self.rows)[:, None]
        pattern[len(self.rows) :] = True
        sparsity = ca.sparsify(ca.DM(pattern.astype(float))).sparsity()
        triangle = ca.Sparsity.upper(size)
        entries, upper = (
            tuple(np.array(part, dtype=np.intp) for part in each.get_triplet())
            for each in (sparsity, triangle)
        )
        one, none = ca.Sparsity.dense(1, 1), ca.Sparsity(0, 0)
        z_, g_ = ca.Sparsity.dense(size), ca.Sparsity.dense(len(pattern))
        shapes = {"x": z_, "lam_x": z_, "f": one, "g": g_, "lam_g": g_}
        results = [shapes.get(ca.nlpsol_out(k), none) for k in range(ca.nlpsol_n_out())]

        def f(z: Array, *_: Array) -> float:
            return self.at(z).outcome.value

        def hessian(z: Array, _: Array, of_objective: Array, multipliers: Array) -> Values:
            return [of_objective[0] * self.hessian(z, multipliers)[upper]]

        table: dict[str, tuple[list[Any], list[Any], Callable[..., Values]]] = {
            "f": ([z_], [one], lambda z: [f(z)]),
            "g": ([z_], [g_], lambda z: [self.limits(z)]),
            "grad_f": ([z_, none], [one, z_], lambda z, _: [f(z), self.at(z).outcome.gradient]),
            "jac_g": (
                [z_, none], [g_, sparsity], lambda z, _: [self.limits(z), self.slopes(z)[entries]]
            ),
            "hess_lag": ([z_, none, one, g_], [triangle], hessian),
            "iteration_callback": (results, [one], lambda z, *_: [float(self.done(z))]),
        }  # fmt: skip
        return {name: _Function(name, *parts, self._failures) for name, parts in table.items()}


def _first_hessian(gradient: Array) -> BFGS:
    """Return a BFGS approximation with Powell's damping that begins at ‖gradient‖ · 1."""
    from scipy.optimize import BFGS

    size = max(1e-3, float(np.linalg.norm(gradient)))
    hessian = BFGS(exception_strategy="damp_update", min_curvature=0.2, init_scale=size)
    hessian.initialize(len(gradient), "hess")
    return hessian


class _Function(ca.Callback):
    """A CasADi function of a Python rule that returns the nonzeros of each output.

    C++ code above a callback would only print its exception. It becomes the first of the failures;
    from then on every function returns NaN, so that Ipopt ends.
    """

    def __init__(
        self, name: str, inputs: list[ca.Sparsity], outputs: list[ca.Sparsity],
        rule: Callable[..., Values], failures: list[BaseException],
    ) -> None:  # fmt: skip
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._rule, self._failures = inputs, outputs, rule, failures
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._inputs[i]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._outputs[i]

    def eval(self, arguments: Sequence[ca.DM]) -> list[ca.DM]:
        if not self._failures:
            try:
                values = self._rule(*(np.asarray(argument).ravel() for argument in arguments))
                return [ca.DM(s, v) for s, v in zip(self._outputs, values, strict=True)]
            except BaseException as exception:  # noqa: BLE001 (raised again after Ipopt)
                self._failures.append(exception)
        return [ca.DM(s, np.full(s.nnz(), np.nan)) for s in self._outputs]
