"""Segments of recordings that a simulation follows: time steps, input, windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.effects import ArmEffect
from lieid_casadi.effects.joint_elasticity import JointElasticity
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.symbolic import symbolic
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import relative_temperature
from lieid_casadi.identification.recording_checks import check_joints
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.recording import Processed, Processing, Recording, process
from lieid_casadi.simulation.integration import STEP, Input, delays_of, integrate
from lieid_casadi.simulation.step import Coordinates


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
    temperature: Array  # (K, n), °C
    substeps: int  # steps between two instants
    h: float  # step, s
    per_window: int  # instants between the start of a window and its end

    @property
    def starts(self) -> Indices:
        """Instants (W,) at which windows start, one after the other."""
        return np.arange((len(self.segment) - 1) // self.per_window) * self.per_window

    def inputs(self, fit: Fit) -> Array:
        """Return the mean input ((K − 1)·substeps, n) in each step.

        Commands are held from row to row of the recording, which delays them by half of that
        interval on average; delays of a fit contain it.
        """
        t, own = self.segment.t, self.segment.recording
        edges = t[0] + np.arange((len(t) - 1) * self.substeps + 1) * self.h
        if self.under == "torque":
            tau = with_torque_of_drives(fit, self.segment).tau
            assert tau is not None
            return np.column_stack([np.interp(edges[:-1] + 0.5 * self.h, t, x) for x in tau.T])
        assert own.command is not None
        late = np.maximum(delays_of(fit) - 0.5 / own.rate, 0.0)
        rows = np.append(own.t[0] - late.max() - 1.0, own.t)
        held = np.vstack([own.command[:1], own.command[:-1]]) * np.diff(rows)[:, None]
        passed = np.vstack([np.zeros(len(late)), np.cumsum(held, axis=0)])
        integral = [np.interp(edges - d, rows, x) for d, x in zip(late, passed.T, strict=True)]
        return np.asarray(np.diff(integral).T / self.h)


def run_of(fit: Fit, segment: Processed, window: float, under: Input) -> Run:
    """Return a segment, whose temperatures are relative to the fit's, for windows in s."""
    t = segment.t
    interval = float(t[-1] - t[0]) / (len(t) - 1)
    substeps = max(1, int(np.ceil(interval / STEP - 1e-9)))
    warm = np.zeros_like(segment.q) if segment.temperature is None else segment.temperature
    warm = warm + (0.0 if fit.temperature_mean is None else fit.temperature_mean)
    per_window = max(1, round(window / interval))
    return Run(segment, under, warm, substeps, interval / substeps, per_window)


def runs_of(fit: Fit, recording: Recording, window: float, under: Input) -> list[Run]:
    """Return the segments of a recording, for windows in s."""
    options = Processing(cutoff=fit.processing.cutoff, trim=0.0)
    segments = (relative_temperature(s, fit.temperature_mean) for s in process(recording, options))
    return [run_of(fit, segment, window, under) for segment in segments]


def with_coefficients(fit: Fit, values: Array) -> Fit:
    """Return a fit with other coefficients (m,) of its effects."""
    parameters = np.concatenate([fit.link_parameters, values])
    return replace(fit, parameters=parameters, values=fit.model.base.combination @ parameters)


def motions(
    fits: Sequence[Fit],
    run: Run,
    starts: Indices,
    *,
    length: int | None = None,
    compiled: bool = False,
    threads: int = 1,
) -> Array:
    """Return the states (length + 1, W, S) of motions from the measured states at starts (W,).

    ``fits``: one, or one per motion, of one model. ``length``: instants, by default a window.
    """
    unique = list({id(fit): fit for fit in fits}.values())
    places = {id(fit): k for k, fit in enumerate(unique)}
    own = np.broadcast_to([places[id(fit)] for fit in fits], len(starts))
    along = [Coordinates.of(fit).along(fit, run.segment) for fit in unique]
    x, dx = (np.stack([each[k] for each in along])[own, starts] for k in (0, 1))
    inputs, m = np.stack([run.inputs(fit) for fit in unique]), run.substeps

    def signals(k: int, part: Indices) -> tuple[Array, Array, Array]:
        at = starts[part] * m + k
        return inputs[own[part], at], run.temperature[at // m], np.asarray(at * run.h)

    count = run.per_window if length is None else length
    return integrate(
        fits, x, dx, signals, h=run.h, steps=count * m, every=m, under=run.under,
        compiled=compiled, threads=threads,
    )  # fmt: skip


def window_errors(fits: Sequence[Fit], run: Run, starts: Indices) -> Array:
    """Return simulated minus measured positions (W, T, n) in windows, after their starts."""
    path = motions(fits, run, starts)[1:, :, : fits[0].model.n]
    rows = starts + np.arange(1, run.per_window + 1)[:, None]
    return np.asarray((path - run.segment.q[rows]).transpose(1, 0, 2))
