"""A fit refined on the motion that it predicts under commands, an optional last step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.compiled.compiled_model import default_threads
from lieid_casadi.effects.backlash import Backlash
from lieid_casadi.effects.command_delay import CommandDelay
from lieid_casadi.effects.torque_saturation import TorqueSaturation
from lieid_casadi.errors import ModelError
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import center_temperature, training_rms
from lieid_casadi.recording import Recording, process
from lieid_casadi.recording.recording import listed
from lieid_casadi.simulation.integration import LEAST_ERROR
from lieid_casadi.simulation.runs import (
    Run,
    input_of,
    motions,
    require_positive_mass_matrix,
    runs_of,
    with_coefficients,
)

LONGEST_DELAY = 0.5  # s
MOST_WINDOWS = 60
COMPARED = 0.05  # s between the instants at which positions are compared
DIFFERENCE = 0.02  # of a coefficient's size, for derivatives
SPREAD = 0.5  # prior standard deviation of a coefficient around the fit's, relative to its size


@dataclass(frozen=True, eq=False)
class Polished:
    """The refined fit, and the RMS error in position (n,) within the windows before and after."""

    fit: Fit
    before: Array  # rad
    after: Array


def polish(
    fit: Fit,
    recordings: Recording | Sequence[Recording],
    *,
    window: float = 1.0,
    iterations: int = 10,
    progress: Callable[[str, float], None] | None = None,
) -> Polished:
    """Refine the effects of a fit so that the simulated motion is that of recordings.

    Regression of filtered torques is biased where friction changes its sign and where positions
    are coarse. From the fit's solution, its effects' coefficients are changed within their bounds
    such that windows of the motion, which start in measured states, are reproduced (prediction
    error, by least squares on compiled simulations). Inertias remain those of the fit, which has a
    drive law and is of method ``feasible``; the recordings are those of the fit, with commanded
    positions. ``window`` is in s, ``iterations`` the largest number of derivatives.

    ModelError: no commands or drives, or the mass matrix is not positive definite.
    """
    given, report = listed(recordings), progress or (lambda stage, fraction: None)
    input_of(fit, given, "command")
    runs = [run for recording in given for run in runs_of(fit, recording, window, "command")]
    runs = [run for run in runs if len(run.starts)]
    if not runs:
        raise ModelError(f"no segment has the length of a window of {window:g} s")
    require_positive_mass_matrix(fit, runs)
    problem = _Problem.of(fit, runs)
    before = problem.errors([fit])[0]
    scale = np.maximum(np.sqrt(np.nanmean(before**2, axis=0)), LEAST_ERROR)
    done = 0

    def residual(x: Array) -> Array:
        errors = problem.errors([problem.fit_at(x)])[0] / scale
        return np.append(np.nan_to_num(errors, nan=1e3).ravel(), (x - problem.start) / SPREAD)

    def jacobian(x: Array) -> Array:
        nonlocal done
        done += 1
        report("polish", min(done / iterations, 1.0))
        # away from the nearer bound
        steps = np.where(x + DIFFERENCE <= problem.upper, DIFFERENCE, -DIFFERENCE)
        changed = [x, *(x + np.diag(steps))]
        every = np.nan_to_num(problem.errors([problem.fit_at(y) for y in changed]) / scale, nan=1e3)
        slopes = (every[1:] - every[0]).reshape(len(x), -1).T / steps
        return np.vstack([slopes, np.eye(len(x)) / SPREAD])

    found = least_squares(
        residual, problem.start, jac=jacobian, bounds=(problem.lower, problem.upper),
        max_nfev=iterations, loss="soft_l1", f_scale=2.0,
    )  # fmt: skip
    refined = _with_errors(problem.fit_at(found.x), given)
    after = problem.errors([refined])[0]
    return Polished(refined, *(np.sqrt(np.mean(e**2, axis=0)) for e in (before, after)))


def _with_errors(fit: Fit, recordings: Sequence[Recording]) -> Fit:
    """Return a fit with its own errors of training in place of those before."""
    drives = fit.model.robot.drives
    assert drives is not None
    whole = [r if r.tau is not None else r.with_drives(drives) for r in recordings]
    segments, _ = center_temperature(process(whole, fit.processing), fit.temperature_mean)
    rms, raw = training_rms(fit.compiled, segments, fit.parameters, fit.shapes)
    return replace(fit, rms_train=rms, rms_train_raw=raw)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Coefficients that are refined, in units of their sizes, and the segments."""

    fit: Fit
    runs: Sequence[Run]
    columns: Indices  # of the effects' coefficients
    sizes: Array
    lower: Array
    upper: Array

    @classmethod
    def of(cls, fit: Fit, runs: Sequence[Run]) -> _Problem:
        own = [(p.effect, c) for p in fit.model.placements for c in p.effect.coefficients]
        used = [
            k
            for k, (effect, _) in enumerate(own)
            if not isinstance(effect, (Backlash, TorqueSaturation))
        ]
        columns, values = np.array(used, dtype=np.intp), fit.effect_coefficients
        names = np.array([column.name for column in fit.model.columns])
        typical = {x: float(np.median(np.abs(values[names == x]))) for x in set(names)}
        sizes = np.array([max(abs(values[k]), 0.3 * typical[names[k]], 1e-4) for k in used])
        signs = [0.0 if own[k][1].opposes_motion else own[k][1].lower for k in used]
        lower = np.minimum(np.array(signs), values[columns]) / sizes
        upper = np.array([own[k][1].upper for k in used]) / sizes
        delays = [isinstance(own[k][0], CommandDelay) for k in used]
        upper = np.where(delays, np.minimum(upper, LONGEST_DELAY / sizes), upper)
        return cls(fit, runs, columns, sizes, lower - 1e-9, upper)

    @property
    def start(self) -> Array:
        """The coefficients of the fit."""
        return np.asarray(self.fit.effect_coefficients[self.columns] / self.sizes)

    def fit_at(self, x: Array) -> Fit:
        """Return the fit with other coefficients."""
        values = self.fit.effect_coefficients.copy()
        values[self.columns] = x * self.sizes
        return with_coefficients(self.fit, values)

    def errors(self, fits: Sequence[Fit]) -> Array:
        """Return simulated minus measured positions (F, R, n) of fits, at all compared instants."""
        found, many, n = [], len(fits), self.fit.model.n
        for run in self.runs:
            starts = run.starts[:: max(1, -(-len(run.starts) // MOST_WINDOWS))]
            step = max(1, round(COMPARED / (run.substeps * run.h)))
            rows = np.arange(step, run.per_window + 1, step)
            path = motions(
                [fit for fit in fits for _ in starts], run, np.tile(starts, many), compiled=True,
                threads=default_threads(),
            )[rows, :, :n].reshape(len(rows), many, len(starts), n)  # fmt: skip
            error = path - run.segment.q[starts + rows[:, None]][:, None]
            found.append(error.transpose(1, 0, 2, 3).reshape(many, -1, n))
        return np.concatenate(found, axis=1)
