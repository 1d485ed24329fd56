"""Parameters of one night: effect coefficients fitted again, inertias within their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import joint_factors
from lieid_casadi.identification.temperature import center_temperature
from lieid_casadi.identification.uncertainty.noise_model import RATE_OVER_CUTOFF
from lieid_casadi.model import Parameter
from lieid_casadi.recording import Processed, Recording, process

Array = NDArray[np.float64]
LEAST_VARIANCE = 1e-12  # relative to the largest: below it a parameter counts as exactly known
UNDETERMINED = 1e-9  # of scaled columns: directions that the night does not excite


@dataclass(frozen=True, eq=False)
class NightEstimate:
    """Effect coefficients of one night.

    Attributes
    ----------
    parameters : tuple of Parameter
        Coefficients of effects that are base parameters.
    values, std : (k,)
        Estimates and nominal standard deviations, from the noise of the fit alone.
    torque_rms : (n,)
        RMS of the measured torque in motion, N·m.
    unexplained : (n,)
        Part of the torque (0 to 1, in terms of RMS) that the robot's regressor cannot explain
        even if all its parameters are fitted to this night.
    unexplained_over_noise : (n,)
        The same error in multiples of the noise.
    """

    parameters: tuple[Parameter, ...]
    values: Array
    std: Array
    torque_rms: Array
    unexplained: Array
    unexplained_over_noise: Array


def night_estimate(fit: Fit, recording: Recording, noise: Array) -> NightEstimate:
    """Estimate a night's effect coefficients.

    Inertial parameters have the fit's estimate and covariance as prior, coefficients of effects
    are free. A change of friction is therefore not reduced by the prior, and errors of the
    inertial parameters enter the standard deviations.

    Parameters
    ----------
    fit : Fit
    recording : Recording
        Checked against the model.
    noise : (n,)
        Held-out error of the fit, N·m.
    """
    segments, _ = center_temperature(process([recording], fit.processing), fit.temperature_mean)
    rows = Design(fit.compiled, segments).rows(fit.shapes, fit.parameters)
    sizes = noise * np.sqrt(_rows_per_independent(segments[0]))
    factors = joint_factors(
        rows, [np.full(len(j.torque), 1.0 / s) for j, s in zip(rows.joints, sizes, strict=True)]
    )
    stacked = np.concatenate([factor.r for factor in factors])
    matrix, torque = stacked[:, :-1], stacked[:, -1]
    effects = np.flatnonzero(fit.model.base.kept >= 10 * fit.model.n)
    change, covariance = _with_prior(matrix, torque - matrix @ fit.values, _prior(fit, effects))
    torque_norm = np.array([np.linalg.norm(factor.r[:, -1]) for factor in factors])
    misfit = np.sqrt([factor.misfit(_free(matrix, torque)) for factor in factors])
    root = np.sqrt(np.maximum([factor.rows for factor in factors], 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        unexplained = np.nan_to_num(misfit / torque_norm)
    return NightEstimate(
        tuple(fit.model.base_columns[k] for k in effects),
        (fit.values + change)[effects],
        np.sqrt(np.maximum(np.diag(covariance)[effects], 0.0)),
        torque_norm / root * sizes,
        unexplained,
        misfit / root * sizes / noise,
    )


def _rows_per_independent(segment: Processed) -> float:
    """Return the number of filtered rows per independent one."""
    time = segment.filtered_time
    rate = 1.0 / (time[1] - time[0]) if len(time) > 1 else 1.0
    return float(max(1.0, rate / (RATE_OVER_CUTOFF * segment.cutoff)))


def _prior(fit: Fit, effects: NDArray[np.intp]) -> Array:
    """Return rows (k, p) of a prior with unit variance on the inertial parameters."""
    count = len(fit.values)
    links = np.setdiff1d(np.arange(count), effects)
    sizes, axes = np.linalg.eigh(fit.covariance[np.ix_(links, links)])
    least = LEAST_VARIANCE * max(float(sizes.max(initial=0.0)), 1e-300)
    rows = np.zeros((len(links), count))
    rows[:, links] = (axes / np.sqrt(np.maximum(sizes, least))).T
    return rows


def _with_prior(matrix: Array, residual: Array, prior: Array) -> tuple[Array, Array]:
    """Return the change of the parameters (p,) and its covariance (p, p), weighted to unit noise.

    Directions that neither the night nor the prior determines stay at zero, with the standard
    deviation that the tolerance gives.
    """
    both = np.concatenate([matrix, prior])
    target = np.concatenate([residual, np.zeros(len(prior))])
    scale = np.linalg.norm(both, axis=0)
    scale[scale == 0.0] = 1.0
    u, sizes, vt = np.linalg.svd(both / scale, full_matrices=False)
    least = UNDETERMINED * sizes.max(initial=1e-300)
    used = sizes > least
    change = vt[used].T @ ((u[:, used].T @ target) / sizes[used]) / scale
    spread = vt.T / np.maximum(sizes, least) / scale[:, None]
    return change, spread @ spread.T


def _free(matrix: Array, torque: Array) -> Array:
    """Return the least-squares estimate (p,) without a prior."""
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq(matrix / scale, torque, rcond=UNDETERMINED)[0] / scale)
