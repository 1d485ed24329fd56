"""Effects as functions of signals, evaluated on NumPy arrays without compiling a model.

A search evaluates columns of one effect at many values of its shape parameters. Compiling each
would take longer than the evaluation, and CasADi's virtual machine evaluates samples one by one;
here its expressions are evaluated on arrays, operation by operation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy.special import erf

from lieid_casadi.arrays import Array
from lieid_casadi.effects import Effect, Signals
from lieid_casadi.expressions.model_functions import ramp

OWN = ("q", "dq", "ddq", "sign", "load", "temperature", "time", "command_error")


@cache
def _sign() -> ArrayFunction:
    dq, width = ca.SX.sym("dq"), ca.SX.sym("width")
    return ArrayFunction([dq, width], [ramp(dq, width)])


def sign_of(dq: Array, dead_zone: Array) -> Array:
    """Return the sign of velocities (K, n), which changes gradually over a dead zone (n,)."""
    return np.asarray(_sign()(dq, dead_zone)[0])


@dataclass(frozen=True)
class _Further:
    """Signals of further joints, by their numbers from 0."""

    joints: Mapping[int, Signals]

    def of(self, joint: int) -> Signals:
        """Return the signals of a joint."""
        return self.joints[joint]


class EffectFunction:
    """One effect as a function of the signals of its joint, and of others that it reads."""

    def __init__(self, effect: Effect) -> None:
        self.effect = effect
        self._shape = {shape.name: ca.SX.sym(shape.name) for shape in effect.shapes}
        self._state = {state.name: ca.SX.sym(state.name) for state in effect.states}

    def at(self, values: Mapping[str, Array], grid: Array) -> Array:
        """Return the columns (c, N, G) of an effect with one shape parameter (G,)."""
        own = [values[name][:, None] for name in OWN]
        results = self._columns(*own, *own, grid)
        shape = (len(own[0]), len(grid))
        return np.array([np.broadcast_to(x, shape) for x in results])

    def columns(
        self, values: Mapping[str, Array], places: Sequence[tuple[int, int | None]], grid: Array
    ) -> Array:
        """Return the columns (K, places, G, c), not filtered.

        ``values`` are signals (K, n) by name, ``places`` joints and sources (None except for
        couplings); the grid is (G, s), or (places, G, s) with other values at each place.
        """
        shapes, signals = np.moveaxis(grid, -1, 0)[..., None], self._arrays(values, places)
        size = (len(places), grid.shape[-2], signals[0].shape[-1])
        results = self._columns(*signals, *shapes, *self._states(signals, shapes, size))
        # time is the last axis in memory: operations and filters are then fast
        return np.moveaxis(np.stack([np.broadcast_to(x, size) for x in results], axis=2), -1, 0)

    @cached_property
    def _columns(self) -> ArrayFunction:
        signals, symbols = self._signals(self._state)
        inputs = [*symbols, *self._shape.values(), *self._state.values()]
        return ArrayFunction(inputs, self.effect.columns(signals, self._shape))

    def _signals(self, state: Mapping[str, ca.SX]) -> tuple[Signals, list[ca.SX]]:
        """Return the signals of a place, and their symbols in the order of `_arrays`."""
        count = 2 + len(self.effect.joints)
        joints: list[dict[str, Any]] = [{x: ca.SX.sym(x) for x in OWN} for _ in range(count)]
        own, other, *further = joints
        others = {j: Signals(**x) for j, x in zip(self.effect.joints, further, strict=True)}
        coupled = Signals(**other) if self.effect.couples else None
        signals = Signals(**own, other=coupled, state=dict(state), every=_Further(others))
        return signals, [symbol for each in (own, other, *further) for symbol in each.values()]

    def _arrays(
        self, values: Mapping[str, Array], places: Sequence[tuple[int, int | None]]
    ) -> list[Array]:
        """Return the signals (places, 1, K) of the joints, of sources, and of further joints."""
        own = other = [values[name].T[[j for j, _ in places], None] for name in OWN]
        if self.effect.couples:
            other = [values[name].T[[s or 0 for _, s in places], None] for name in OWN]
        further = [values[name].T[[j], None] for j in self.effect.joints for name in OWN]
        return [*own, *other, *further]

    @cached_property
    def _step(self) -> tuple[ArrayFunction, list[int] | None]:
        """The step of the states between samples, and the inputs that it depends on.

        A step x ← a·x + b, of states that do not depend on each other, is the function of a and b;
        any other step (no inputs are named) is that of the states after it.
        """
        (before, first), (now, second) = self._signals(self._state), self._signals({})
        every, inputs = [*self._state.values()], [*first, *second, *self._shape.values()]
        after = ca.vertcat(*self.effect.advance(before, now, self._shape))
        factors = ca.jacobian(after, ca.vertcat(*every))
        apart = (factors - ca.diag(ca.diag(factors))).is_zero()
        if not apart or ca.depends_on(factors, ca.vertcat(*every)):
            step = self.effect.next_states(before, now, self._shape)
            return ArrayFunction([*every, *inputs], step), None
        added = ca.substitute(after, ca.vertcat(*every), ca.DM.zeros(len(every), 1))
        used = [k for k, symbol in enumerate(inputs) if ca.depends_on(after, symbol)]
        both = [*ca.vertsplit(ca.diag(factors)), *ca.vertsplit(added)]
        return ArrayFunction(inputs, both), used

    def _states(
        self, signals: Sequence[Array], shapes: Array, size: tuple[int, int, int]
    ) -> list[Array]:
        """Return each state along a segment (places, G, K).

        A step x ← a·x + b is evaluated for all samples at once, any other sample by sample.
        """
        if not self._state:
            return []
        values = [*(x[..., :-1] for x in signals), *(x[..., 1:] for x in signals), *shapes]
        initial = [np.full(size[:2], state.initial) for state in self.effect.states]
        step, used = self._step
        if used is None:
            return _step_by_step(step, values, initial, size[2])
        found, count = step(*values), len(initial)
        finite = np.full((*size[:2], size[2] - 1), True)
        for x in (*(values[k] for k in used), *found):  # as `Effect.next_states`
            finite &= np.isfinite(x)
        return [
            _recurrence(np.where(finite, a, 1.0), np.where(finite, b, 0.0), x)
            for a, b, x in zip(found[:count], found[count:], initial, strict=True)
        ]


def _recurrence(a: Array, b: Array, initial: Array) -> Array:
    """Return x (…, K + 1) with x[…, k + 1] = a[…, k]·x[…, k] + b[…, k], for a and b (…, K).

    The steps are composed within blocks of √K samples, in all at once; then blocks are linked.
    """
    steps = a.shape[-1]
    block = max(int(np.sqrt(steps)), 1)
    blocks = -(-steps // block)
    padding = (*[(0, 0)] * (a.ndim - 1), (0, blocks * block - steps))
    shape = (*a.shape[:-1], blocks, block)
    factor = np.pad(a, padding, constant_values=1.0).reshape(shape)
    added = np.pad(b, padding).reshape(shape)
    for k in range(1, block):
        added[..., k] += factor[..., k] * added[..., k - 1]
        factor[..., k] *= factor[..., k - 1]
    first, last = np.empty(shape[:-1]), initial
    for k in range(blocks):
        first[..., k], last = last, factor[..., k, -1] * last + added[..., k, -1]
    x = (factor * first[..., None] + added).reshape(*shape[:-2], -1)
    return np.concatenate([initial[..., None], x[..., :steps]], axis=-1)


def _step_by_step(
    step: ArrayFunction, values: Sequence[Array], initial: Sequence[Array], samples: int
) -> list[Array]:
    """Return each state (places, G, K), from a function of the states and the inputs of a step.

    ``values`` are signals before and after each step (places, 1, K − 1), and shape parameters,
    which are the same in all steps (…, G, 1).
    """
    states = [np.empty((*x.shape, samples)) for x in initial]
    for state, x in zip(states, initial, strict=True):
        state[..., 0] = x
    for k in range(samples - 1):
        inputs = [x[..., min(k, x.shape[-1] - 1)] for x in values]
        after = step(*(state[..., k] for state in states), *inputs)
        for state, x in zip(states, after, strict=True):
            state[..., k + 1] = x
    return states


#: Operations that CasADi and NumPy call by the same name.
_SAME_NAMES = (
    "add", "pow", "exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2",
    "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "log1p", "expm1", "hypot",
    "floor", "ceil", "fmod", "fabs", "sign", "copysign",
)  # fmt: skip
_OPERATIONS: dict[int, Callable[..., Any]] = {
    **{getattr(ca, f"OP_{name.upper()}"): getattr(np, name) for name in _SAME_NAMES},
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_CONSTPOW: np.power,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda x: 2.0 * x,
    ca.OP_LT: lambda x, y: np.less(x, y).astype(float),
    ca.OP_LE: lambda x, y: np.less_equal(x, y).astype(float),
    ca.OP_EQ: lambda x, y: np.equal(x, y).astype(float),
    ca.OP_NE: lambda x, y: np.not_equal(x, y).astype(float),
    ca.OP_NOT: lambda x: np.equal(x, 0.0).astype(float),
    ca.OP_AND: lambda x, y: np.logical_and(x, y).astype(float),
    ca.OP_OR: lambda x, y: np.logical_or(x, y).astype(float),
    ca.OP_IF_ELSE_ZERO: lambda condition, value: np.where(condition != 0.0, value, 0.0),
    ca.OP_ERF: erf,
    ca.OP_FMIN: np.minimum,
    ca.OP_FMAX: np.maximum,
    ca.OP_INV: np.reciprocal,
}


class ArrayFunction:
    """A function of scalars, evaluated on arrays that broadcast against each other.

    Parameters
    ----------
    inputs : sequence of ca.SX
        Scalar symbols.
    outputs : sequence of ca.SX
        Scalar expressions of them.

    Examples
    --------
    >>> import casadi as ca, numpy as np
    >>> x, y = ca.SX.sym("x"), ca.SX.sym("y")
    >>> function = ArrayFunction([x, y], [ca.sin(x) * y, x])
    >>> [float(v[1]) for v in function(np.array([0.0, 1.0]), 2.0)]
    [1.682941969615793, 1.0]
    """

    def __init__(self, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]) -> None:
        f = ca.Function("f", list(inputs), [ca.SX(x) for x in outputs], {"cse": True})
        self._count = len(outputs)
        self._program = []
        for k in range(f.n_instructions()):
            code, arguments = f.instruction_id(k), f.instruction_input(k)
            constant = f.instruction_constant(k) if code == ca.OP_CONST else 0.0
            self._program.append((code, arguments, f.instruction_output(k), constant))
            if code not in (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT) and code not in _OPERATIONS:
                raise NotImplementedError(
                    f"CasADi operation {code} has no NumPy equivalent here; add it to _OPERATIONS"
                )

    def __call__(self, *inputs: Array | float) -> list[Array]:
        """Return the value of each output."""
        work: dict[int, Any] = {}
        results: list[Any] = [0.0] * self._count
        with np.errstate(all="ignore"):
            for code, arguments, target, constant in self._program:
                if code == ca.OP_CONST:
                    work[target[0]] = constant
                elif code == ca.OP_INPUT:
                    work[target[0]] = inputs[arguments[0]]
                elif code == ca.OP_OUTPUT:
                    results[target[0]] = work[arguments[0]]
                else:
                    work[target[0]] = _OPERATIONS[code](*(work[a] for a in arguments))
        return results
