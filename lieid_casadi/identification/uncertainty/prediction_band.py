"""Uncertainty of a predicted torque, from the covariance of the parameters and the noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import norm

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ModelError
from lieid_casadi.identification.prediction import on_recording_times, torque_along
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.recording.processed import Processed
from lieid_casadi.recording.recording import Recording

if TYPE_CHECKING:
    from lieid_casadi.identification.fit import Fit

STEP = 1e-4  # of a shape's size, for the torque's slope


@dataclass(frozen=True, eq=False)
class PredictionBand:
    """Torque with its uncertainty, (N, n) each, N·m.

    Attributes
    ----------
    torque
        As `Fit.predict` returns it.
    lower, upper
        Bounds that contain a measured sample with probability ``level`` if the model is correct.
    parameter_std
        Standard deviation of the torque due to that of the parameters alone.
    level
        Probability.
    """

    torque: Array
    lower: Array
    upper: Array
    parameter_std: Array
    level: float


def predict_band(fit: Fit, recording: Recording, *, level: float = 0.95) -> PredictionBand:
    """Return the torque at the recording's own times with its bounds.

    The bounds include the uncertainty of base and shape parameters (to first order) and noise of
    the size of the unfiltered training error.

    Parameters
    ----------
    level : float
        Probability, between 0 and 1.

    Returns
    -------
    PredictionBand

    Raises
    ------
    ModelError
        A recording with another number of joints, or a level outside 0 to 1.
    """
    if not 0.0 < level < 1.0:
        raise ModelError(f"level is {level}, expected a probability between 0 and 1")
    fit.check_joints(recording)

    def torque_and_variance(segment: Processed) -> Array:
        torque = torque_along(fit.compiled, segment, fit.parameters, fit.shapes)
        slopes = _slopes(fit, segment)
        variance = np.einsum("knp,pq,knq->kn", slopes, fit.covariance, slopes, optimize=True)
        return np.hstack([torque, variance])

    both = on_recording_times(
        recording, fit.processing, fit.temperature_mean, torque_and_variance, 2 * fit.model.n
    )
    torque, variance = np.hsplit(both, 2)
    variance = np.maximum(variance, 0.0)  # rounding
    half = norm.ppf(0.5 + 0.5 * level) * np.sqrt(variance + fit.rms_train_raw**2)
    return PredictionBand(torque, torque - half, torque + half, np.sqrt(variance), level)


def _slopes(fit: Fit, segment: Processed) -> Array:
    """Return the torque's derivatives (K, n, p + s) by base values and shapes."""
    base = fit.model.base
    columns = fit.compiled.rigid_base_regressor(segment.q, segment.dq, segment.ddq)
    effects = effects_along(fit.compiled, segment, fit.shapes, fit.parameters, fitted=False)
    kept = base.kept - 10 * fit.model.n
    columns[:, :, kept >= 0] = effects[:, :, kept[kept >= 0]]
    if not len(fit.shapes):
        return columns
    here = torque_along(fit.compiled, segment, fit.parameters, fit.shapes)
    slopes = []
    for k, size in enumerate(fit.shapes):
        moved = fit.shapes.copy()
        moved[k] += STEP * max(abs(size), STEP)
        there = torque_along(fit.compiled, segment, fit.parameters, moved)
        slopes.append((there - here) / (moved[k] - size))
    return np.concatenate([columns, np.stack(slopes, axis=2)], axis=2)
