"""One run of Ipopt, called through CasADi, on a program that consists of Python functions.

A CasADi graph of the whole program would hold the criterion's eigenvalue decomposition, which
CasADi does not differentiate, and thousands of limits, of which some hundred matter at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
