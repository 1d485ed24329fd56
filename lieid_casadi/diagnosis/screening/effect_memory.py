"""States of effects with memory along a segment, in many places and at many shape parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.numpy_evaluation import ArrayFunction
from lieid_casadi.effects import Effect, Signals

Array = NDArray[np.float64]
OWN = ("q", "dq", "ddq", "sign", "load", "temperature", "time", "command_error")


def signals_of(own: Mapping[str, ca.SX]) -> Signals:
    """Return the signals of one joint from their symbols by name (`OWN`)."""
    q, dq, ddq, sign, load, temperature, time, error = (own[name] for name in OWN)
    return Signals(q, dq, ddq, sign, load, temperature, time, command_error=error)


def states_along(effect: Effect, own: Sequence[Array], grid: Array) -> list[Array]:
    """Return each state along a segment (K, places, G).

    A step x ← a·x + b, of one state that does not depend on the others, is evaluated for all
    samples at once; any other step sample by sample.

    Parameters
    ----------
    effect : Effect
    own : sequence of (K, places, 1)
        Signals of the places, as `OWN`.
    grid : (G, s)
        Shape parameters.
    """
    before, now, states = (_symbols(names) for names in (OWN, OWN, [s.name for s in effect.states]))
    shapes = _symbols([shape.name for shape in effect.shapes])
    inputs = [*before.values(), *now.values(), *shapes.values()]
    signals = replace(signals_of(before), state=states), signals_of(now)
    values = [*(x[:-1] for x in own), *(x[1:] for x in own), *grid.T]
    size = (len(own[0]), own[0].shape[1], len(grid))
    initial = [np.full(size[1:], s.initial) for s in effect.states]
    after = ca.vertcat(*effect.advance(*signals, shapes))
    every = ca.vertcat(*states.values())
    factors = ca.jacobian(after, every)
    apart = (factors - ca.diag(ca.diag(factors))).is_zero()
    if not apart or ca.depends_on(factors, every):
        step = ArrayFunction([*states.values(), *inputs], effect.next_states(*signals, shapes))
        return _step_by_step(step, values, initial, len(own[0]))
    added = ca.substitute(after, every, ca.DM.zeros(every.shape))
    found = ArrayFunction(inputs, [*ca.vertsplit(ca.diag(factors)), *ca.vertsplit(added)])(*values)
    used = [x for symbol, x in zip(inputs, values, strict=True) if ca.depends_on(after, symbol)]
    finite = np.full((size[0] - 1, *size[1:]), True)
    for x in (*used, *found):  # as `Effect.next_states`
        finite &= np.isfinite(x)
    count = len(initial)
    return [
        _recurrence(np.where(finite, a, 1.0), np.where(finite, b, 0.0), x)
        for a, b, x in zip(found[:count], found[count:], initial, strict=True)
    ]


def _symbols(names: Sequence[str]) -> dict[str, ca.SX]:
    return {name: ca.SX.sym(name) for name in names}


def _recurrence(a: Array, b: Array, initial: Array) -> Array:
    """Return x (K + 1, …) with x[k + 1] = a[k]·x[k] + b[k], for a and b (K, …).

    The steps are composed within blocks of √K samples, in all blocks at once; then the blocks are
    linked.
    """
    steps = len(a)
    block = max(int(np.sqrt(steps)), 1)
    blocks = -(-steps // block)
    padding = ((0, blocks * block - steps), *[(0, 0)] * (a.ndim - 1))
    shape = (blocks, block, *a.shape[1:])
    factor = np.pad(a, padding, constant_values=1.0).reshape(shape)
    added = np.pad(b, padding).reshape(shape)
    for k in range(1, block):
        added[:, k] += factor[:, k] * added[:, k - 1]
        factor[:, k] *= factor[:, k - 1]
    first = np.empty((blocks, *a.shape[1:]))
    last = initial
    for k in range(blocks):
        first[k], last = last, factor[k, -1] * last + added[k, -1]
    x = (factor * first[:, None] + added).reshape(-1, *a.shape[1:])
    return np.concatenate([initial[None], x[:steps]])


def _step_by_step(
    step: ArrayFunction, values: Sequence[Array], initial: Sequence[Array], samples: int
) -> list[Array]:
    """Return each state (K, places, G), from a function of the states and the inputs of a step.

    Parameters
    ----------
    step : ArrayFunction
    values : sequence of (K − 1, places, 1) or (G,)
        Signals before and after each step, and shape parameters.
    initial : sequence of (places, G)
    samples : int
        K.
    """
    states = [np.empty((samples, *x.shape)) for x in initial]
    for state, x in zip(states, initial, strict=True):
        state[0] = x
    for k in range(samples - 1):
        inputs = [x[k] if x.ndim == 3 else x for x in values]
        after = step(*(state[k] for state in states), *inputs)
        for state, x in zip(states, after, strict=True):
            state[k + 1] = x
    return states
