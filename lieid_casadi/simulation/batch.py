"""Many motions at once by compiled steps: arrays in, arrays out."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled.batch_evaluation import Evaluation, evaluation_of_one
from lieid_casadi.compiled.compiled_model import default_threads
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.model_functions import SparseFunction
from lieid_casadi.identification.fit import Fit
from lieid_casadi.simulation.play import Coordinates, plays_of
from lieid_casadi.simulation.runs import FARTHEST, STEP, Input, delays_of
from lieid_casadi.simulation.step import initial_state, step_function

STEPS_KEPT = 8  # compiled step functions of models
FEWEST = 64  # motions per thread


def simulate_batch(
    fits: Fit | Sequence[Fit],
    q: ArrayLike,
    dq: ArrayLike,
    inputs: ArrayLike,
    *,
    interval: float,
    history: int = 0,
    under: Input | None = None,
    threads: int | None = None,
) -> tuple[Array, Array]:
    """Integrate many motions at once, each with its own start, inputs and, if wanted, its own arm.

    The integrator is that of `simulate`, compiled to C that takes several motions per instruction.
    The first call for a model compiles it, which takes seconds; it is kept in the user's cache.

    Parameters
    ----------
    fits : Fit or sequence of Fit
        One for all motions, or one for each of the W motions, such as ``fit.sample(W)``: of one
        model, with the same plays.
    q, dq : (W, n)
        Positions and velocities at the start, rad and rad/s.
    inputs : (T, W, n)
        Commanded positions, rad, or torques, N·m, of T intervals; held within each. Delays of
        commands that the fit states contain half of an interval.
    interval : float
        s; it is divided into steps of at most 1 ms.
    history : int
        Number of the inputs that precede the start, which delayed commands need.
    under : {"command", "torque"}, optional
        What the inputs are; commands if the robot has drives. The temperature is that of training.
    threads : int, optional
        That share the motions; two if left out.

    Returns
    -------
    q, dq : (T + 1, W, n)
        At the start and at the end of each interval; NaN once a motion has left every range.

    Raises
    ------
    ModelError
        Arrays of other shapes, fits of different models, or commands without drives.
    """
    given = [fits] if isinstance(fits, Fit) else list(fits)
    first, n = given[0], given[0].model.n
    start, speed, inputs = (np.asarray(x, dtype=float) for x in (q, dq, inputs))
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
    steps = max(1, int(np.ceil(interval / STEP - 1e-9)))
    numbers = np.array([np.concatenate([f.parameters, f.shapes]) for f in given])
    delays = np.array([delays_of(f) for f in given]) if chosen == "command" else np.zeros((1, n))
    batch = _Batch(
        _compiled_step(first, chosen == "command"), first, interval / steps, steps, history
    )
    numbers, delays = (np.broadcast_to(x, (windows, x.shape[1])) for x in (numbers, delays))
    late = np.maximum(delays - 0.5 * interval, 0.0)
    count = max(1, min(default_threads() if threads is None else threads, windows // FEWEST))
    parts = np.array_split(np.arange(windows), count)

    def run(part: np.typing.NDArray[np.intp]) -> Array:
        return batch.run(start[part], speed[part], inputs[:, part], numbers[part], late[part])

    with ThreadPoolExecutor(count) as pool:
        path = np.concatenate(list(pool.map(run, parts)), axis=1)
    d = Coordinates.of(first).size
    return path[:, :, :n], path[:, :, d : d + n]


_COMPILED: dict[tuple[object, ...], tuple[Evaluation, Fit]] = {}  # the fit keeps its robot's id


def _compiled_step(fit: Fit, commanded: bool) -> Evaluation:
    """Return the step of all fits with the same robot, effects and plays, compiled once."""
    model, mean = fit.model, fit.temperature_mean
    key = (
        id(model.robot), tuple(p.label for p in model.placements), plays_of(fit),
        None if mean is None else mean.tobytes(), commanded,
    )  # fmt: skip
    if key not in _COMPILED:
        function = step_function(fit, model.robot.drives if commanded else None, parametric=True)
        size = function.size1_out(0)
        rows, columns = np.arange(size), np.zeros(size, dtype=np.intp)
        sparse = SparseFunction(function, rows, columns, (size, 1))
        if len(_COMPILED) >= STEPS_KEPT:
            del _COMPILED[next(iter(_COMPILED))]
        _COMPILED[key] = evaluation_of_one("step", sparse), fit
    return _COMPILED[key][0]


@dataclass(frozen=True, eq=False)
class _Batch:
    """A step, and what is the same for all motions."""

    step: Evaluation
    fit: Fit
    h: float  # s
    substeps: int  # within an interval
    history: int  # inputs that precede the start

    def run(self, q: Array, dq: Array, inputs: Array, numbers: Array, late: Array) -> Array:
        """Return the states (T + 1, W, S) of motions from q, dq (W, n) on.

        ``late`` (W, n) is the delay of the inputs (T, W, n), s.
        """
        windows, n = q.shape
        links = [play.joint for play in plays_of(self.fit)]
        x, dx = np.hstack([q, q[:, links]]), np.hstack([dq, dq[:, links]])
        state = np.ascontiguousarray(initial_state(self.fit, x, dx).T)
        intervals = len(inputs) - self.history
        path = np.empty((intervals + 1, *state.shape))
        path[0] = state
        mean = self.fit.temperature_mean
        warm = np.zeros(n) if mean is None else mean
        values = {
            "state": state,
            "input": np.empty((windows, n)),
            "temperature": np.tile(warm, (windows, 1)),
            "time": np.empty((windows, 1)),
            "h": np.full((windows, 1), self.h),
            "numbers": np.ascontiguousarray(numbers),
        }
        bound, after = self.step.bind(values), np.empty((*state.shape, 1))
        at = np.arange(windows)[:, None], np.arange(n)
        for k in range(intervals * self.substeps):
            begin = (k - late / self.h) / self.substeps  # of the step, in intervals
            row = np.floor(begin + 1e-9)
            part = np.minimum((row + 1.0 - begin) * self.substeps, 1.0)  # before the next input
            own = np.maximum(row.astype(int) + self.history, 0)
            after_it = np.minimum(own + 1, len(inputs) - 1)
            values["input"][:] = part * inputs[own, *at] + (1.0 - part) * inputs[after_it, *at]
            values["time"][:] = k * self.h
            bound.dense(after, 1)
            state[:] = after[:, :, 0]
            if (k + 1) % self.substeps == 0:
                state[~(np.abs(state[:, : 2 * x.shape[1]]) < FARTHEST).all(axis=1)] = np.nan
                path[(k + 1) // self.substeps] = state
        return path
