"""Many motions at once by the time step of a model: arrays in, arrays out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.compiled.batch_evaluation import Evaluation, MachineEvaluation, evaluation_of_one
from lieid_casadi.compiled.compiled_model import default_threads
from lieid_casadi.effects.command_delay import CommandDelay
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.model_functions import column_function
from lieid_casadi.identification.fit import Fit
from lieid_casadi.simulation.step import Coordinates, initial_state, plays_of, step_function

Input = Literal["command", "torque"]
#: Input (W, n), temperature (W, n) and time (W,) in a step, of some of the motions.
Signals = Callable[[int, Indices], tuple[Array, Array, Array]]
STEP = 1e-3  # s, longest step
FARTHEST = 1e3  # rad, at which a simulation has left every range
LEAST_ERROR = 1e-4  # rad, below which an error in position does not count
STEPS_KEPT = 8  # step functions of models
FEWEST = 64  # motions per thread


def integrate(
    fits: Sequence[Fit],
    x: Array,
    dx: Array,
    signals: Signals,
    *,
    h: float,
    steps: int,
    every: int,
    under: Input,
    compiled: bool,
    threads: int = 1,
) -> Array:
    """Return the states (steps/every + 1, W, S) of motions after every so many steps of h seconds.

    ``fits``: one, or one per motion, of one model with the same plays. ``x``, ``dx`` (W, d): see
    `Coordinates`. ``compiled``: by generated C, whose compilation takes seconds, and not by
    CasADi's virtual machine. States are NaN once a motion has left every range.
    """
    step = _step_of(fits[0], under, compiled)
    numbers = np.array([np.concatenate([f.parameters, f.shapes]) for f in fits])
    numbers = np.broadcast_to(numbers, (len(x), numbers.shape[1]))

    def run(part: Indices) -> Array:
        state = np.ascontiguousarray(initial_state(fits[0], x[part], dx[part]).T)
        path = np.empty((steps // every + 1, *state.shape))
        path[0] = state
        given, temperature, time = signals(0, part)
        values = {
            "state": state,
            "input": given.copy(),
            "temperature": temperature.copy(),
            "time": time[:, None].copy(),
            "h": np.full((len(part), 1), h),
            "numbers": np.ascontiguousarray(numbers[part]),
        }
        bound, after = step.bind(values), np.empty((*state.shape, 1))
        for k in range(steps):
            given, temperature, time = signals(k, part)
            values["input"][:], values["temperature"][:] = given, temperature
            values["time"][:, 0] = time
            bound.dense(after, 1)
            state[:] = after[:, :, 0]
            if (k + 1) % every == 0:
                state[~(np.abs(state[:, : 2 * x.shape[1]]) < FARTHEST).all(axis=1)] = np.nan
                path[(k + 1) // every] = state
        return path

    count = max(1, min(threads, len(x) // FEWEST))
    with ThreadPoolExecutor(count) as pool:
        parts = np.array_split(np.arange(len(x)), count)
        return np.concatenate(list(pool.map(run, parts)), axis=1)


_STEPS: dict[tuple[object, ...], tuple[Evaluation, Fit]] = {}  # the fit keeps its robot's id


def _step_of(fit: Fit, under: Input, compiled: bool) -> Evaluation:
    """Return the step of all fits with the same robot, effects and plays, made once."""
    model, mean = fit.model, fit.temperature_mean
    key = (
        id(model.robot), tuple(p.label for p in model.placements), plays_of(fit),
        None if mean is None else mean.tobytes(), under, compiled,
    )  # fmt: skip
    if key not in _STEPS:
        drives = model.robot.drives if under == "command" else None
        sparse = column_function(step_function(fit, drives))
        if len(_STEPS) >= STEPS_KEPT:
            del _STEPS[next(iter(_STEPS))]
        machine = MachineEvaluation([sparse], [0], sparse.shape)
        _STEPS[key] = evaluation_of_one("step", sparse) if compiled else machine, fit
    return _STEPS[key][0]


def delays_of(fit: Fit) -> Array:
    """Return the delay (n,) of the commands that a fit states, s."""
    delays = np.zeros(fit.model.n)
    for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True):
        if column.name == f"{CommandDelay.name}.delta":
            delays[column.joint] = max(float(value), 0.0)
    return delays


@dataclass(frozen=True, eq=False)
class Batch:
    """Starts and inputs of W motions, for `lieid_casadi.simulate`.

    Attributes
    ----------
    q, dq : (W, n)
        Positions and velocities at the start, rad and rad/s.
    inputs : (T, W, n)
        Commanded positions, rad, or torques, N·m, each held for an ``interval``, s. Delays that a
        fit states contain half of an interval.
    interval : float
    history : int
        Number of inputs that precede the start, as delayed commands need.
    """

    q: ArrayLike
    dq: ArrayLike
    inputs: ArrayLike
    interval: float
    history: int = 0


def integrate_batch(
    fits: Fit | Sequence[Fit], batch: Batch, under: Input | None, threads: int | None
) -> tuple[Array, Array]:
    """Return the motions of a batch: see `lieid_casadi.simulate`."""
    given = [fits] if isinstance(fits, Fit) else list(fits)
    first, n = given[0], given[0].model.n
    start, speed, inputs = (np.asarray(x, dtype=float) for x in (batch.q, batch.dq, batch.inputs))
    interval, history = batch.interval, batch.history
    windows = len(start)
    if inputs.ndim != 3 or not start.shape == speed.shape == inputs.shape[1:] == (windows, n):
        raise ModelError(
            f"shapes q {start.shape}, dq {speed.shape}, inputs {inputs.shape}; expected (W, {n}), "
            f"(W, {n}), (T, W, {n})"
        )
    labels = [p.label for p in first.model.placements]
    if len(given) not in (1, windows) or any(
        [p.label for p in f.model.placements] != labels or plays_of(f) != plays_of(first)
        for f in given
    ):
        raise ModelError(f"{len(given)} fits; expected one, or one per motion, of the same effects")
    chosen = under or ("command" if first.model.robot.drives else "torque")
    if chosen == "command" and first.model.robot.drives is None:
        raise ModelError("commands need drives; expected torques, or a fit with a drive law")
    m = max(1, int(np.ceil(interval / STEP - 1e-9)))
    h, links = interval / m, [play.joint for play in plays_of(first)]
    late = np.zeros((windows, n))
    if chosen == "command":
        late += np.maximum(np.array([delays_of(f) for f in given]) - 0.5 * interval, 0.0)
    warm = np.zeros(n) if first.temperature_mean is None else first.temperature_mean
    joints = np.arange(n)

    def signals(k: int, part: Indices) -> tuple[Array, Array, Array]:
        begin = (k - late[part] / h) / m  # of the step, in intervals
        row = np.floor(begin + 1e-9)
        share = np.minimum((row + 1.0 - begin) * m, 1.0)  # of the step, before the next input
        own = np.maximum(row.astype(int) + history, 0)
        after = np.minimum(own + 1, len(inputs) - 1)
        at = part[:, None], joints
        mean = share * inputs[own, *at] + (1.0 - share) * inputs[after, *at]
        return mean, np.tile(warm, (len(part), 1)), np.full(len(part), k * h)

    path = integrate(
        given, np.hstack([start, start[:, links]]), np.hstack([speed, speed[:, links]]), signals,
        h=h, steps=(len(inputs) - history) * m, every=m, under=chosen, compiled=True,
        threads=default_threads() if threads is None else threads,
    )  # fmt: skip
    d = Coordinates.of(first).size
    return path[:, :, :n], path[:, :, d : d + n]
