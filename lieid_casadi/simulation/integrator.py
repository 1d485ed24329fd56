"""Integration of segments by one step function."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.effects.command_delay import CommandDelay
from lieid_casadi.identification.fit import Fit
from lieid_casadi.simulation.play import Coordinates
from lieid_casadi.simulation.runs import Input, Run
from lieid_casadi.simulation.step import initial_state, step_function
from lieid_casadi.simulation.torque_signal import with_torque_of_drives

FARTHEST = 1e3  # rad, at which a simulation has left every range


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulated motion of one run (K, n), and its errors at the windows' ends (W, n)."""

    t: Array
    q: Array
    dq: Array
    end_errors: Array


class Integrator:
    """Integration of runs by the step function of a fit.

    ``under``: the input.
    """

    def __init__(self, fit: Fit, under: Input) -> None:
        self._fit = fit
        self._coordinates = Coordinates.of(fit)
        self._step = step_function(fit, fit.model.robot.drives if under == "command" else None)

    def windows(self, run: Run, *, every: int = 1) -> Simulated:
        """Return the motion in consecutive windows, or every k-th, from the measured states."""
        segment, n = run.segment, self._fit.model.n
        length = run.per_window
        starts = np.arange(0, run.windows, every) * length
        path = self._paths(run, starts, length)  # (length + 1, W, d)
        ends = path[-1, :, :n] - segment.q[starts + length]
        d = self._coordinates.size
        inside = path[:-1].transpose(1, 0, 2).reshape(len(starts) * length, -1)
        rows = (starts[:, None] + np.arange(length)).ravel()
        return Simulated(segment.t[rows], inside[:, :n], inside[:, d : d + n], ends)

    def whole(self, run: Run) -> Array:
        """Return the errors (K, n) of the motion from the first state of the segment."""
        path = self._paths(run, np.zeros(1, dtype=int), len(run.segment) - 1)
        return np.asarray(path[:, 0, : self._fit.model.n] - run.segment.q)

    def _delays(self) -> Array:
        """Return the delay (n,) of the commands that the fit states, s."""
        fit = self._fit
        delays = np.zeros(fit.model.n)
        for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True):
            if column.name == f"{CommandDelay.name}.delta":
                delays[column.joint] = max(float(value), 0.0)
        return delays

    def _paths(self, run: Run, starts: NDArray[np.int_], length: int) -> Array:
        """Return states (length + 1, W, d) from the measured states at the starts (W,)."""
        segment, m, windows = run.segment, run.substeps, len(starts)
        chunk = self._step.mapaccum("chunk", m).map(windows) if windows else None
        x, dx = self._coordinates.along(self._fit, segment)
        state = initial_state(self._fit, x[starts], dx[starts])
        path = np.empty((length + 1, windows, len(state)))
        path[0] = state.T
        if chunk is None:
            return path
        if run.under == "torque":
            run = replace(run, segment=with_torque_of_drives(self._fit, segment))
        inputs = run.inputs(self._delays())
        steps = np.full((1, windows * m), run.h)
        for k in range(length):
            columns = ((starts + k) * m)[:, None] + np.arange(m)
            time = columns.ravel() * run.h
            warm = np.repeat(run.temperature[:, starts + k], m, axis=1)
            found = chunk(state, inputs[:, columns.ravel()], warm, time[None], steps).full()
            state = found[:, m - 1 :: m]
            lost = ~(np.abs(state[: 2 * self._coordinates.size]) < FARTHEST).all(axis=0)
            state[:, lost] = np.nan
            path[k + 1] = state.T
        return path
