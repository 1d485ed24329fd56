"""Number of independent samples per second of a correlated residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification import Fit
from lieid_casadi.recording import Recording, process

Array = NDArray[np.float64]


def independent_rate(fit: Fit, recordings: Sequence[Recording]) -> Array:
    """Return the independent samples per second of each joint's residual (n,).

    A residual with the autocorrelations ρ_k at lags of h s has as much information as
    1/(h·(1 + 2·Σρ_k)) independent samples per second. The sum ends where the correlogram first
    falls below zero. The result is at most twice the cut-off frequency of the fit's filter.

    Parameters
    ----------
    fit : Fit
    recordings : sequence of Recording
        Along which the residual is computed; without any, twice the cut-off is returned.
    """
    cutoff = fit.processing.cutoff
    assert cutoff is not None
    rates = np.full(fit.model.n, 2.0 * cutoff)
    for recording in recordings:
        fit.check_joints(recording)
        for segment in process(recording, fit.processing):
            if segment.tau is None:
                continue
            residual = segment.filter(segment.tau) - fit.predict_processed(segment)
            step = (segment.kept.step or 1) / segment.rate
            own = [1.0 / (step * correlation_sum(e)) for e in residual.T]
            rates = np.minimum(rates, own)
    return rates


def correlation_sum(residual: Array) -> float:
    """Return 1 + 2·Σρ_k of a residual (M,), at least 1."""
    centred = residual - residual.mean()
    size = len(centred)
    spectrum = np.abs(np.fft.rfft(centred, 2 * size)) ** 2
    covariance = np.fft.irfft(spectrum)[:size]
    if covariance[0] <= 0.0:
        return 1.0
    correlation = covariance / covariance[0]
    negative = np.flatnonzero(correlation < 0.0)
    end = int(negative[0]) if len(negative) else size
    return max(1.0, float(1.0 + 2.0 * correlation[1:end].sum()))
