"""Standard deviations that allow for residuals correlated in time and between joints.

After a low-pass, neighbouring residuals are nearly the same number (lag-1 correlation
0.97-0.99 at the recording's rate), so the white-noise formula is several times too small.
Here the long-run covariance of the scores x·e is estimated with a Bartlett kernel after
AR(1) prewhitening (Andrews & Monahan, Econometrica 1992; bandwidth by Andrews, 1991).

Limits: it needs many times more instants than the residual's memory, says nothing about
errors in q, and treats model error as if it were noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification.design import Rows

Array = NDArray[np.float64]
STRONGEST_MEMORY = 0.97  # a prewhitening filter nearer to 1 would only amplify its own error


def hac_covariance(
    rows: Rows, weights: Sequence[Array], residuals: Sequence[Array], unit_covariance: Array
) -> Array:
    """Return the covariance of least-squares values (p, p).

    Parameters
    ----------
    weights : sequence of (R,)
        Of each joint's rows (multiplying them).
    residuals : sequence of (R,)
        Unweighted, N·m.
    unit_covariance : (p, p)
        (XᵀX)⁻¹ of the weighted rows.
    """
    instants, p = int(rows.segments[-1]), rows.count
    scores = np.zeros((instants, p))
    for joint, weight, residual in zip(rows.joints, weights, residuals, strict=True):
        # each instant occurs at most once per joint
        scores[np.ix_(joint.instant, joint.columns)] += (
            joint.matrix * (weight**2 * residual)[:, None]
        )
    segments = [scores[a:b] for a, b in zip(rows.segments[:-1], rows.segments[1:], strict=True)]
    effective = max(instants - p / max(len(rows.joints), 1), 1.0)
    middle = long_run_covariance(segments) * instants * (instants / effective)
    return np.asarray(unit_covariance @ middle @ unit_covariance)


def long_run_covariance(segments: Sequence[Array]) -> Array:
    """Return the long-run covariance (p, p) per instant of a zero-mean series in segments."""
    memory = _memory(segments)
    white = [s[1:] - memory * s[:-1] for s in segments if len(s) > 1]
    count = sum(len(s) for s in white)
    lags = _bandwidth(white, count)
    total = sum((s.T @ s for s in white), start=np.zeros((len(memory),) * 2))
    for lag in range(1, lags + 1):
        taper = 1.0 - lag / (lags + 1.0)
        for s in white:
            if len(s) > lag:
                product = s[lag:].T @ s[:-lag]
                total = total + taper * (product + product.T)
    color = 1.0 / (1.0 - memory)
    return np.asarray(total / max(count, 1) * np.outer(color, color))


def _memory(segments: Sequence[Array]) -> Array:
    """Return the lag-1 autocorrelation of each column (p,)."""
    zero = np.zeros(segments[0].shape[1])
    power = sum((np.sum(s * s, axis=0) for s in segments), start=zero)
    lagged = sum((np.sum(s[1:] * s[:-1], axis=0) for s in segments if len(s) > 1), start=zero)
    ratio = np.divide(lagged, power, out=np.zeros_like(power), where=power > 0)
    return np.asarray(np.clip(ratio, -STRONGEST_MEMORY, STRONGEST_MEMORY))


def _bandwidth(segments: Sequence[Array], count: int) -> int:
    """Return the number of Bartlett lags by Andrews' AR(1) plug-in."""
    rho = _memory(segments)
    power = sum((np.sum(s * s, axis=0) for s in segments), start=np.zeros_like(rho))
    variance = (power / max(count, 1)) * (1.0 - rho**2)
    scale = variance.max(initial=0.0)
    if scale <= 0.0:
        return 0
    share = (variance / scale) ** 2
    above = np.sum(share * 4.0 * rho**2 / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2))
    below = np.sum(share / (1.0 - rho) ** 4)
    alpha = above / below if below > 0 else 0.0
    return int(min(np.ceil(1.1447 * (alpha * count) ** (1.0 / 3.0)), max(count // 4, 0)))
