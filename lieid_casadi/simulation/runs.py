"""Segments of recordings that a simulation follows: time steps, input, integration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.effects import ArmEffect
from lieid_casadi.effects.command_delay import CommandDelay
from lieid_casadi.effects.joint_elasticity import JointElasticity
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.symbolic import symbolic
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import relative_temperature
from lieid_casadi.identification.recording_checks import check_joints
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.recording import Processed, Processing, Recording, process
from lieid_casadi.simulation.play import Coordinates
from lieid_casadi.simulation.step import initial_state, step_function


def with_torque_of_drives(fit: Fit, segment: Processed) -> Processed:
    """Return a segment whose torque is that of the drives: without gains, filters, delays.

    A fit states the measured torque as that of the drives plus what effects on the measurement add
    (τ_measured = (1 + g)·τ, say). The addition along the measured motion is subtracted.
    """
    effects = [p.effect for p in fit.model.placements for _ in p.effect.coefficients]
    own = np.array([_is_of_sensors(effect) for effect in effects], dtype=bool)
    if not own.any():
        return segment
    assert segment.tau is not None  # checked with the input
    columns = effects_along(fit.compiled, segment, fit.shapes, fit.parameters, fitted=False)
    return replace(segment, tau=segment.tau - columns[:, :, own] @ fit.effect_coefficients[own])


def _is_of_sensors(effect: object) -> bool:
    """Return whether an effect changes what sensors read, apart from links beside their motors."""
    return (
        isinstance(effect, ArmEffect)
        and effect.on_measurement
        and not effect.commanded
        and not isinstance(effect, JointElasticity)
    )


Input = Literal["command", "torque"]
STEP = 1e-3  # s, longest step
POSES = 500  # at which the mass matrix is checked


def input_of(fit: Fit, recordings: Sequence[Recording], under: Input | None) -> Input:
    """Return the input that all recordings have: ``under``, or by default commands if possible.

    `ModelError`: a recording lacks it, or has another number of joints.
    """
    for recording in recordings:
        check_joints(fit.model, recording)
    commands = all(r.command is not None for r in recordings) and bool(fit.model.robot.drives)
    torques = all(r.tau is not None for r in recordings)
    if under is None:
        under = "command" if commands else "torque"
    if under == "command" and not commands:
        raise ModelError(
            "simulation under commands needs columns qcmd1… in all recordings and a drive law in "
            "the fit (--stiffness, --servo)"
        )
    if under == "torque" and not torques:
        raise ModelError(
            f"{recordings[0].title}: no torque; expected columns tau1…tau{fit.model.n}, or "
            "qcmd1… with a fit that has a drive law"
        )
    return under


def require_positive_mass_matrix(fit: Fit, runs: Sequence[Run]) -> None:
    """Raise `ModelError` if the mass matrix of a measured pose is not positive definite."""
    mass = symbolic(fit, allow_indefinite=True).mass_matrix
    poses = np.concatenate([run.segment.q for run in runs])
    poses = poses[:: max(1, len(poses) // POSES)]
    n = fit.model.n
    matrices = mass(poses.T).full().reshape(n, len(poses), n).transpose(1, 0, 2)
    least = np.linalg.eigvalsh(matrices)[:, 0]
    if least.min() <= 0.0:
        raise ModelError(
            "the mass matrix of the fit is not positive definite in "
            f"{100.0 * np.mean(least <= 0.0):.0f} % of the measured poses, so that accelerations "
            "have the wrong sign; identify with --method feasible (and with the effect armature "
            "if torque is that of motor currents)"
        )


@dataclass(frozen=True, eq=False)
class Run:
    """A segment and its time steps."""

    segment: Processed  # of K instants
    under: Input
    temperature: Array  # (n, K), °C
    substeps: int  # steps between two instants
    h: float  # step, s
    per_window: int  # instants between the start of a window and its end

    @property
    def windows(self) -> int:
        """Number of windows."""
        return (len(self.segment) - 1) // self.per_window

    def inputs(self, delays: Array) -> Array:
        """Return the input (n, (K − 1)·substeps) in the middle of each step.

        Commands are held from row to row of the recording, which delays them by half of that
        interval on average; delays (n,), s, of a fit contain it.
        """
        t, own = self.segment.t, self.segment.recording
        middle = t[0] + (np.arange((len(t) - 1) * self.substeps) + 0.5) * self.h
        if self.under == "torque":
            assert self.segment.tau is not None
            return np.stack([np.interp(middle, t, x) for x in self.segment.tau.T])
        assert own.command is not None
        late = middle - np.maximum(delays - 0.5 / own.rate, 0.0)[:, None]
        rows = np.maximum(np.searchsorted(own.t, late, side="right") - 1, 0)
        return np.take_along_axis(own.command.T, rows, axis=1)


def runs_of(fit: Fit, recording: Recording, window: float, under: Input) -> list[Run]:
    """Return the segments of a recording, for windows in s; too short ones are left out."""
    options = Processing(cutoff=fit.processing.cutoff, trim=0.0)
    made = []
    for raw in process(recording, options):
        segment = relative_temperature(raw, fit.temperature_mean)
        t = segment.t
        interval = float(t[-1] - t[0]) / (len(t) - 1)
        substeps = max(1, int(np.ceil(interval / STEP - 1e-9)))
        h = interval / substeps
        mean = np.zeros(fit.model.n) if fit.temperature_mean is None else fit.temperature_mean
        warm = mean + (
            np.zeros_like(segment.q) if segment.temperature is None else segment.temperature
        )
        per_window = max(1, round(window / interval))
        made.append(Run(segment, under, warm.T, substeps, h, per_window))
    return made


def delays_of(fit: Fit) -> Array:
    """Return the delay (n,) of the commands that a fit states, s."""
    delays = np.zeros(fit.model.n)
    for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True):
        if column.name == f"{CommandDelay.name}.delta":
            delays[column.joint] = max(float(value), 0.0)
    return delays


FARTHEST = 1e3  # rad, at which a simulation has left every range


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulated motion of one run (K, n), and its errors at the windows' ends (W, n)."""

    t: Array
    q: Array
    dq: Array
    end_errors: Array


class Integrator:
    """Integration of runs by the step function of a fit."""

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

    def _paths(self, run: Run, starts: NDArray[np.int_], length: int) -> Array:
        """Return states (length + 1, W, d) from the measured states at the starts (W,)."""
        segment, m, windows = run.segment, run.substeps, len(starts)
        x, dx = self._coordinates.along(self._fit, segment)
        state = initial_state(self._fit, x[starts], dx[starts])
        path = np.empty((length + 1, windows, len(state)))
        path[0] = state.T
        if not windows:
            return path
        chunk = self._step.mapaccum("chunk", m).map(windows)
        if run.under == "torque":
            run = replace(run, segment=with_torque_of_drives(self._fit, segment))
        inputs = run.inputs(delays_of(self._fit))
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
