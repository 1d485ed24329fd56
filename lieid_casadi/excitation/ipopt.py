"""One run of Ipopt, called through CasADi, on a program that consists of Python functions.

A CasADi graph of the whole program would hold the criterion's eigenvalue decomposition, which
CasADi does not differentiate, and thousands of limits, of which some hundred matter at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.excitation.criteria import ObjectiveValue
from lieid_casadi.excitation.limits import ConstraintRows, SampledConstraints
from lieid_casadi.excitation.trajectory import MotionSamples

if TYPE_CHECKING:
    from scipy.optimize import BFGS

Values = Sequence[float | Array]
PUSH = 1e-4  # distance from their bound of slacks that start on it
CONVERGED = 1e-6  # optimality error; the callers stop Ipopt earlier
QUIET = {"print_level": 0, "sb": "yes"}


class NonlinearProgram(Protocol):
    """min f(z) with g(z) ≤ 0; every method takes z (m,)."""

    pattern: NDArray[np.bool_]
    """Entries (rows, m) of ∂g/∂z that can be nonzero."""
    linear: bool
    """Whether ∂g/∂z is constant."""

    def value(self, z: Array) -> float:
        """Return f."""

    def gradient(self, z: Array) -> Array:
        """Return ∂f/∂z (m,)."""

    def limits(self, z: Array) -> Array:
        """Return g (rows,)."""

    def slopes(self, z: Array) -> Array:
        """Return ∂g/∂z (rows, m)."""

    def hessian(self, z: Array, multipliers: Array) -> Array:
        """Return the Lagrangian's Hessian (m, m), or an approximation."""

    def done(self, z: Array) -> bool:
        """Record an iterate (the first is the start of the run); return whether to stop there."""


@dataclass(eq=False)
class CallbackFailure:
    """The first exception of a callback; C++ code above the callback would only print it.

    From then on every callback returns NaN, so that Ipopt ends.
    """

    exception: BaseException | None = None


def run_ipopt(
    program: NonlinearProgram,
    z: Array,
    multipliers: Array,
    *,
    radius: float,
    barrier: float,
    iterations: int,
) -> Array:
    """Run Ipopt from z and return the multipliers (rows,); iterates go to ``program.done``.

    Parameters
    ----------
    program : NonlinearProgram
    z : (m,)
        Start.
    multipliers : (rows,)
        First multipliers.
    radius : float
        Largest change of each variable.
    barrier : float
        Barrier parameter μ, constant during the run, so that it ends on the central path.
    iterations : int
        At most.

    Raises
    ------
    BaseException
        Any exception of the program's methods, KeyboardInterrupt included.
    """
    failure = CallbackFailure()
    try:
        multipliers = _run(program, z, multipliers, failure, radius, barrier, iterations)
    except RuntimeError as error:
        # KeyboardInterrupt while CasADi asks a function for its shapes
        if "KeyboardInterrupt" in str(error):
            raise KeyboardInterrupt from error
        raise
    if failure.exception is not None:
        raise failure.exception
    return multipliers


def _run(
    program: NonlinearProgram,
    z: Array,
    multipliers: Array,
    failure: CallbackFailure,
    radius: float,
    barrier: float,
    iterations: int,
) -> Array:
    """Return the multipliers; see `run_ipopt`."""
    x = ca.MX.sym("z", len(z))
    # CasADi keeps no reference to the Python objects: keep them as long as the solver
    functions = _functions(program, len(z), failure)
    options: dict[str, Any] = {
        "grad_f": functions["grad_f"], "jac_g": functions["jac_g"],
        "hess_lag": functions["hess_lag"], "iteration_callback": functions["iteration_callback"],
        "no_nlp_grad": True, "print_time": False, "show_eval_warnings": False,
        "error_on_fail": False,
        "ipopt": {
            **QUIET, "max_iter": iterations, "tol": CONVERGED, "nlp_scaling_method": "none",
            "mu_strategy": "monotone", "mu_init": barrier, "mu_target": barrier,
            "warm_start_init_point": "yes", "warm_start_slack_bound_push": PUSH,
            "warm_start_slack_bound_frac": PUSH, "warm_start_bound_push": PUSH,
            "warm_start_bound_frac": PUSH, "warm_start_mult_bound_push": 1e-9,
            "acceptable_iter": 0, "jac_d_constant": "yes" if program.linear else "no",
        },
    }  # fmt: skip
    nlp = {"x": x, "f": functions["f"](x), "g": functions["g"](x)}
    solver = ca.nlpsol("excitation", "ipopt", nlp, options)
    result = solver(x0=z, lbx=z - radius, ubx=z + radius, lbg=-np.inf, ubg=0.0, lam_g0=multipliers)
    return np.asarray(result["lam_g"].full().ravel())


def _functions(
    program: NonlinearProgram, size: int, failure: CallbackFailure
) -> dict[str, _Function]:
    """Return the functions under CasADi's names, with CasADi's signatures."""
    rows = len(program.pattern)
    slopes = ca.DM(program.pattern.astype(float))
    sparsity = ca.sparsify(slopes).sparsity()
    entries = tuple(np.array(part, dtype=np.intp) for part in sparsity.get_triplet())
    triangle = ca.Sparsity.upper(size)
    upper = tuple(np.array(part, dtype=np.intp) for part in triangle.get_triplet())
    one, none = ca.Sparsity.dense(1, 1), ca.Sparsity(0, 0)
    z_, g_ = ca.Sparsity.dense(size), ca.Sparsity.dense(rows)
    p = program

    def hessian(z: Array, _: Array, of_objective: Array, multipliers: Array) -> Values:
        return [of_objective[0] * p.hessian(z, multipliers)[upper]]

    def function(name: str, inputs: list[Any], outputs: list[Any], rule: Rule) -> _Function:
        return _Function(name, inputs, outputs, rule, failure)

    return {
        "f": function("f", [z_], [one], lambda z: [p.value(z)]),
        "g": function("g", [z_], [g_], lambda z: [p.limits(z)]),
        "grad_f": function(
            "grad_f", [z_, none], [one, z_], lambda z, _: [p.value(z), p.gradient(z)]
        ),
        "jac_g": function(
            "jac_g", [z_, none], [g_, sparsity],
            lambda z, _: [p.limits(z), p.slopes(z)[entries]],
        ),
        "hess_lag": function("hess_lag", [z_, none, one, g_], [triangle], hessian),
        "iteration_callback": function(
            "iteration_callback", [_of_result(k, z_, g_) for k in range(ca.nlpsol_n_out())], [one],
            lambda z, *_: [float(p.done(z))],
        ),
    }  # fmt: skip


def _of_result(k: int, z: ca.Sparsity, g: ca.Sparsity) -> ca.Sparsity:
    name = ca.nlpsol_out(k)
    shapes = {"x": z, "lam_x": z, "f": ca.Sparsity.dense(1, 1), "g": g, "lam_g": g}
    return shapes.get(name, ca.Sparsity(0, 0))


Rule = Callable[..., Values]


class _Function(ca.Callback):
    """A CasADi function of a Python rule that returns the nonzeros of each output."""

    def __init__(
        self,
        name: str,
        inputs: list[ca.Sparsity],
        outputs: list[ca.Sparsity],
        rule: Rule,
        failure: CallbackFailure,
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
