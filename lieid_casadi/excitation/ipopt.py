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
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.excitation.limits import ConstraintSet
from lieid_casadi.excitation.trajectory import MotionSamples, SampledBasis

if TYPE_CHECKING:
    from scipy.optimize import BFGS

Indices = NDArray[np.intp]
Values = Sequence[float | Array]
NEAR = -0.3  # scaled excess above which a peak becomes a row
FAR = -0.1  # scaled excess below which a row is dropped between runs
VIOLATED = 5e-3  # scaled excess that counts; half of it outside the rows starts another run
JUMP = 0.05  # increase of the scaled excess from which a step is taken back
RADIUS = 0.3  # largest change of a variable in one run; few limits are rows at its start
DECREASE = 0.3  # of the barrier parameter from stage to stage
FUTILE = 20  # runs without a smaller violation that end a stage
PUSH = 1e-4  # distance from their bound of slacks that start on it


@dataclass(frozen=True, eq=False)
class ObjectiveValue:
    """An objective at z: value, gradient (m,), G (p, p) and further limits excess ≤ 0.

    ``excess`` (s,) has the slopes (s, m); most objectives have none.
    """

    value: float
    gradient: Array
    gram: Array
    excess: Array
    slopes: Array


Objective = Callable[[Array], ObjectiveValue]


@dataclass(frozen=True, eq=False)
class ConstraintRows:
    """Selected limits at selected samples: set, quantity, sample, side (+1 upper, −1 lower)."""

    sets: Indices
    quantities: Indices
    samples: Indices
    sides: Indices

    def __len__(self) -> int:
        return len(self.sets)

    @property
    def columns(self) -> tuple[Indices, ...]:
        """The four arrays."""
        return self.sets, self.quantities, self.samples, self.sides

    @cached_property
    def keys(self) -> list[tuple[int, ...]]:
        """The rows as tuples."""
        return list(zip(*(column.tolist() for column in self.columns), strict=True))

    def chosen(self, mask: NDArray[np.bool_]) -> ConstraintRows:
        """Return some of the rows."""
        return ConstraintRows(*(column[mask] for column in self.columns))

    def without(self, other: ConstraintRows) -> ConstraintRows:
        """Return the rows that are not among the other's."""
        known = set(other.keys)
        return self.chosen(np.array([key not in known for key in self.keys], dtype=bool))

    def joined(self, other: ConstraintRows) -> ConstraintRows:
        """Return these rows and the other's that are not among them."""
        pairs = zip(self.columns, other.without(self).columns, strict=True)
        return ConstraintRows(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True, eq=False)
class SampledConstraints:
    """Constraint sets on a grid of times, as scaled excesses of the free variables z.

    The excess is the distance beyond a limit in parts of its scale, plus ``margin``: a motion with
    nonpositive excess keeps the margin from every limit.
    """

    sets: tuple[ConstraintSet, ...]
    sampled: SampledBasis
    margin: float

    def excess(self, motion: MotionSamples) -> list[tuple[Array, Array]]:
        """Return per set the scaled excesses (k, N) above the upper and below the lower limits."""
        result = []
        for limits in self.sets:
            values, scale = limits.values(motion), limits.scale[:, None]
            above = (values - limits.upper[:, None]) / scale + self.margin
            below = (limits.lower[:, None] - values) / scale + self.margin
            result.append((above, below))
        return result

    def largest(self, excess: list[tuple[Array, Array]]) -> float:
        """Return the largest scaled excess."""
        return max(float(side.max()) for pair in excess for side in pair)

    def peaks(self, excess: list[tuple[Array, Array]], threshold: float) -> ConstraintRows:
        """Return the local maxima over time of excesses above a threshold."""
        found: list[tuple[Indices, ...]] = []
        for index, pair in enumerate(excess):
            for side, values in zip((1, -1), pair, strict=True):
                before, after = np.roll(values, 1, axis=1), np.roll(values, -1, axis=1)
                quantity, sample = np.nonzero(
                    (values > threshold) & (values >= before) & (values > after)
                )
                found.append(
                    (np.full_like(quantity, index), quantity, sample, np.full_like(quantity, side))
                )
        return ConstraintRows(*(np.concatenate(column) for column in zip(*found, strict=True)))

    def at(self, excess: list[tuple[Array, Array]], rows: ConstraintRows) -> Array:
        """Return the excesses of rows (R,)."""
        result = np.empty(len(rows))
        for index, (upper, lower) in enumerate(excess):
            own = rows.sets == index
            where = rows.quantities[own], rows.samples[own]
            result[own] = np.where(rows.sides[own] > 0, upper[where], lower[where])
        return result

    def jacobian(self, motion: MotionSamples, rows: ConstraintRows) -> Array:
        """Return ∂excess/∂z (R, n d) of rows."""
        functions = self.sampled.functions  # (n, 4, N, d)
        n, _, _, d = functions.shape
        result = np.zeros((len(rows), n, d))
        for index, limits in enumerate(self.sets):
            own = np.flatnonzero(rows.sets == index)
            if not len(own):
                continue
            samples, place = np.unique(rows.samples[own], return_inverse=True)
            slopes = limits.jacobian(motion.at(samples))
            kinds = slopes.shape[1] // n  # of derivatives of the position, itself included
            slopes = slopes[rows.quantities[own], :, place]  # (R, kinds n)
            factor = rows.sides[own] / limits.scale[rows.quantities[own]]
            slopes = (slopes * factor[:, None]).reshape(-1, kinds, n)
            result[own] = np.einsum(
                "rkj,jkrd->rjd", slopes, functions[:, :kinds, rows.samples[own], :], optimize=True
            )
        return result.reshape(len(rows), n * d)


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point z (m,) of the search with the objective, the motion and the limits there.

    ``excess`` has the scaled excesses (k, N) past the upper and lower limits of every set,
    ``violation`` the largest: at most 0 where every limit holds with its margin.
    """

    z: Array
    outcome: ObjectiveValue
    motion: MotionSamples
    excess: list[tuple[Array, Array]]
    violation: float

    @classmethod
    def at(cls, constraints: SampledConstraints, objective: Objective, z: Array) -> Iterate:
        """Evaluate objective and limits at z (m,)."""
        outcome = objective(z)
        motion = constraints.sampled.motion(z)
        excess = constraints.excess(motion)
        violation = max(constraints.largest(excess), float(outcome.excess.max(initial=-1.0)))
        return cls(z, outcome, motion, excess, violation)


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
        if self.barrier is None:
            self.barrier = min(1e-2, 100.0 * tolerance)
        while True:
            run = IpoptRun(self, objective, rows, state, count, self.barrier, tolerance)
            multipliers = run.solve(multipliers, iterations - count)
            count += max(run.count, 1)
            missing = c.peaks(run.last.excess, 0.5 * VIOLATED).without(rows)
            at_radius = float(np.abs(run.state.z - state.z).max()) > 0.99 * RADIUS
            state = run.state
            violated = state.violation > VIOLATED
            futile = futile + 1 if violated and state.violation > 0.99 * least else 0
            least = min(least, state.violation)
            if count >= iterations or futile >= FUTILE:
                break
            if len(missing):
                new = c.peaks(state.excess, NEAR).joined(c.peaks(run.last.excess, NEAR))
                kept = c.at(state.excess, rows) > FAR
                multipliers, rows = multipliers[kept], rows.chosen(kept).joined(new)
            elif not at_radius:
                if self.barrier <= tolerance or violated:
                    break
                self.barrier = max(DECREASE * self.barrier, tolerance)
        self.barrier = max(DECREASE * self.barrier, tolerance)
        self.stage += 1
        return state.z


class IpoptRun:
    """One run of Ipopt with fixed rows: min f(z) with g(z) ≤ 0, as functions of z (m,).

    Attributes
    ----------
    state : Iterate
        The last iterate from which another run may start.
    last : Iterate
        The last iterate.
    count : int
        Number of iterations.
    pattern : (R, m)
        Entries of ∂g/∂z that can be nonzero.
    linear : bool
        Whether ∂g/∂z is constant.
    """

    def __init__(
        self, solver: Ipopt, objective: Objective, rows: ConstraintRows, state: Iterate,
        before: int, barrier: float, tolerance: float,
    ) -> None:  # fmt: skip
        self.solver, self.objective, self.rows = solver, objective, rows
        self.state = self.last = self._here = state
        self.count, self._before, self._stall = 0, before, 0
        self._barrier, self._enough = barrier, max(tolerance, 0.1 * barrier)
        sets = solver.constraints.sets
        self._nonlinear = np.array([not limits.linear for limits in sets])[rows.sets]
        self._fixed = solver.constraints.jacobian(state.motion, rows)
        self._slopes = state, np.vstack([self._fixed, state.outcome.slopes])
        further = len(state.outcome.excess)
        self.linear = not (self._nonlinear.any() or further)
        own = (self._fixed != 0.0) | self._nonlinear[:, None]
        self.pattern = np.concatenate([own, np.ones((further, len(state.z)), bool)])
        self._curved = state, self._slopes[1]

    def solve(self, multipliers: Array, iterations: int) -> Array:
        """Return the multipliers of all rows; ``multipliers`` are those of the first rows."""
        start, barrier = self.state, self._barrier
        new = barrier / np.maximum(-self._limits(start)[len(multipliers) :], 1e-2)
        return run_ipopt(
            self, start.z, np.append(multipliers, new), radius=RADIUS, barrier=barrier,
            iterations=iterations,
        )[: len(self.rows)]  # fmt: skip

    def value(self, z: Array) -> float:
        """Return f."""
        return self._at(z).outcome.value

    def gradient(self, z: Array) -> Array:
        """Return ∂f/∂z (m,)."""
        return self._at(z).outcome.gradient

    def limits(self, z: Array) -> Array:
        """Return g (R,)."""
        return self._limits(self._at(z))

    def slopes(self, z: Array) -> Array:
        """Return ∂g/∂z (R, m)."""
        return self._slopes_at(self._at(z))

    def hessian(self, z: Array, multipliers: Array) -> Array:
        """Return an approximation of the Lagrangian's Hessian (m, m), updated by the last step."""
        state, solver = self._at(z), self.solver
        before, slopes_before = self._curved
        if solver.hessian is None:
            solver.hessian = _first_hessian(state.outcome.gradient)
        if state is not before:
            slopes, move = self._slopes_at(state), state.z - before.z
            change = state.outcome.gradient - before.outcome.gradient
            change = change + multipliers @ (slopes - slopes_before)
            # rounding would shape the Hessian
            if np.linalg.norm(move) > 1e-14 and change.any():
                solver.hessian.update(move, change)
            self._curved = state, slopes
        matrix: Array = solver.hessian.get_matrix()
        return matrix

    def done(self, z: Array) -> bool:
        """Record an iterate, the start first; return whether to stop there.

        The run ends at a violated limit that is not a row, after two iterations without gain
        inside the limits, or after ten outside of them.
        """
        if self.count == 0 and np.array_equal(z, self.state.z):
            return False
        solver, before = self.solver, self.state
        state = self.last = self._at(z)
        solver.report(solver.stage, self._before + self.count, state)
        self.count += 1
        not_a_row = len(solver.constraints.peaks(state.excess, VIOLATED).without(self.rows)) > 0
        if not_a_row and state.violation > max(before.violation, 0.0) + JUMP:
            return True
        self.state = state
        gain = abs(before.outcome.value - state.outcome.value)
        violated = state.violation > VIOLATED
        if violated:
            gain += abs(before.violation - state.violation)
        self._stall = self._stall + 1 if gain < self._enough else 0
        return not_a_row or self._stall >= (10 if violated else 2)

    def _at(self, z: Array) -> Iterate:
        if not np.array_equal(self._here.z, z):
            self._here = Iterate.at(self.solver.constraints, self.objective, z.copy())
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


def _first_hessian(gradient: Array) -> BFGS:
    """Return a BFGS approximation with Powell's damping that begins at ‖gradient‖ · 1."""
    from scipy.optimize import BFGS

    size = max(1e-3, float(np.linalg.norm(gradient)))
    hessian = BFGS(exception_strategy="damp_update", min_curvature=0.2, init_scale=size)
    hessian.initialize(len(gradient), "hess")
    return hessian


def run_ipopt(
    program: IpoptRun,
    z: Array,
    multipliers: Array,
    *,
    radius: float,
    barrier: float,
    iterations: int,
) -> Array:
    """Run Ipopt from z and return the multipliers (R,); iterates go to ``program.done``.

    No variable changes by more than the radius. The barrier parameter is constant, so that the run
    ends on the central path. Exceptions of the program, KeyboardInterrupt included, are raised
    after Ipopt has ended.
    """
    failure = _CallbackFailure()
    x = ca.MX.sym("z", len(z))
    settings = {
        "print_level": 0, "sb": "yes", "max_iter": iterations,
        "tol": 1e-6,  # the callback stops earlier
        "nlp_scaling_method": "none", "mu_strategy": "monotone", "mu_init": barrier,
        "mu_target": barrier, "warm_start_init_point": "yes",
        "warm_start_slack_bound_push": PUSH, "warm_start_slack_bound_frac": PUSH,
        "warm_start_bound_push": PUSH, "warm_start_bound_frac": PUSH,
        "warm_start_mult_bound_push": 1e-9, "acceptable_iter": 0,
        "jac_d_constant": "yes" if program.linear else "no",
    }  # fmt: skip
    try:
        # CasADi keeps no reference to the Python objects: keep them as long as the solver
        functions = _functions(program, len(z), failure)
        given = ("grad_f", "jac_g", "hess_lag", "iteration_callback")
        options: dict[str, Any] = {name: functions[name] for name in given} | {
            "no_nlp_grad": True, "print_time": False, "show_eval_warnings": False,
            "error_on_fail": False, "ipopt": settings,
        }  # fmt: skip
        nlp = {"x": x, "f": functions["f"](x), "g": functions["g"](x)}
        solver = ca.nlpsol("excitation", "ipopt", nlp, options)
        result = solver(
            x0=z, lbx=z - radius, ubx=z + radius, lbg=-np.inf, ubg=0.0, lam_g0=multipliers
        )
    except RuntimeError as error:
        # KeyboardInterrupt while CasADi asks a function for its shapes
        if "KeyboardInterrupt" in str(error):
            raise KeyboardInterrupt from error
        raise
    if failure.exception is not None:
        raise failure.exception
    return np.asarray(result["lam_g"].full().ravel())


@dataclass(eq=False)
class _CallbackFailure:
    """The first exception of a callback; C++ code above the callback would only print it.

    From then on every callback returns NaN, so that Ipopt ends.
    """

    exception: BaseException | None = None


def _functions(p: IpoptRun, size: int, failure: _CallbackFailure) -> dict[str, _Function]:
    """Return the functions under CasADi's names, with CasADi's signatures."""
    sparsity = ca.sparsify(ca.DM(p.pattern.astype(float))).sparsity()
    entries = tuple(np.array(part, dtype=np.intp) for part in sparsity.get_triplet())
    triangle = ca.Sparsity.upper(size)
    upper = tuple(np.array(part, dtype=np.intp) for part in triangle.get_triplet())
    one, none = ca.Sparsity.dense(1, 1), ca.Sparsity(0, 0)
    z_, g_ = ca.Sparsity.dense(size), ca.Sparsity.dense(len(p.pattern))
    shapes = {"x": z_, "lam_x": z_, "f": one, "g": g_, "lam_g": g_}
    results = [shapes.get(ca.nlpsol_out(k), none) for k in range(ca.nlpsol_n_out())]

    def hessian(z: Array, _: Array, of_objective: Array, multipliers: Array) -> Values:
        return [of_objective[0] * p.hessian(z, multipliers)[upper]]

    table: dict[str, tuple[list[Any], list[Any], Callable[..., Values]]] = {
        "f": ([z_], [one], lambda z: [p.value(z)]),
        "g": ([z_], [g_], lambda z: [p.limits(z)]),
        "grad_f": ([z_, none], [one, z_], lambda z, _: [p.value(z), p.gradient(z)]),
        "jac_g": ([z_, none], [g_, sparsity], lambda z, _: [p.limits(z), p.slopes(z)[entries]]),
        "hess_lag": ([z_, none, one, g_], [triangle], hessian),
        "iteration_callback": (results, [one], lambda z, *_: [float(p.done(z))]),
    }
    return {name: _Function(name, *parts, failure) for name, parts in table.items()}


class _Function(ca.Callback):
    """A CasADi function of a Python rule that returns the nonzeros of each output."""

    def __init__(
        self,
        name: str,
        inputs: list[ca.Sparsity],
        outputs: list[ca.Sparsity],
        rule: Callable[..., Values],
        failure: _CallbackFailure,
    ) -> None:
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._rule, self._failure = inputs, outputs, rule, failure
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
        if self._failure.exception is None:
            try:
                values = self._rule(*(np.asarray(argument).ravel() for argument in arguments))
                return [ca.DM(s, v) for s, v in zip(self._outputs, values, strict=True)]
            except BaseException as exception:  # noqa: BLE001 (raised again after Ipopt)
                self._failure.exception = exception
        return [ca.DM(s, np.full(s.nnz(), np.nan)) for s in self._outputs]
