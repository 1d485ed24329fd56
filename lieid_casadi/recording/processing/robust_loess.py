"""RLOESS: robust local quadratic regression of acceleration and torque (paper, section 6.2)."""

from __future__ import annotations

import numpy as np
from scipy.signal import oaconvolve

from lieid_casadi.recording.arrays import Array

#: Span in periods of the cut-off: shorter ones follow single outliers, longer ones round off
#: the steps of friction.
SPAN = 1.5
#: Samples in a span, at least.
LEAST_SAMPLES = 7
#: Passes with robust weights, and residual that gets no weight, in median absolute deviations:
#: those of MATLAB's ``smooth(…, 'rloess')``, which the paper used.
ROBUST_PASSES, REJECTED = 5, 6.0
#: Weight of an outlier, so that spans that hold nothing else still have a parabola.
LEAST_WEIGHT = 1e-9


def robust_loess(t: Array, x: Array, cutoff: float) -> Array:
    """Smooth signals over 1.5 periods of the cut-off.

    Each value is that of a parabola, fitted to the samples of the span around it with tricube
    weights (W. S. Cleveland, J. Am. Stat. Assoc. 74, 1979, with degree 2). The fit is repeated
    with bisquare weights of the residuals, so that outliers lose their weight, which no linear
    filter can do; for the same reason the smoothed torque has not gone through the columns'
    filter alone.

    Parameters
    ----------
    t
        (K,) uniform instants, s.
    x
        (K, n) signals.
    cutoff
        Hz; the span is 1.5 / cutoff seconds.

    Returns
    -------
    (K, n)
    """
    rate = (t.size - 1) / float(t[-1] - t[0])
    half = max(LEAST_SAMPLES, SPAN * rate / cutoff) / 2.0
    offsets = np.arange(-int(half), int(half) + 1) / half
    kernel = (1.0 - np.abs(offsets) ** 3) ** 3
    return np.column_stack([_smooth(column, offsets, kernel) for column in x.T])


def _smooth(x: Array, offsets: Array, kernel: Array) -> Array:
    """Return one smoothed signal (K,); offsets and kernel are those of a span's samples."""
    weights = np.ones_like(x)
    smooth = _local_parabolas(x, weights, offsets, kernel)
    for _ in range(ROBUST_PASSES):
        residual = np.abs(x - smooth)
        scale = REJECTED * np.median(residual)
        if scale <= 1e-12 * np.abs(x).max():
            break
        weights = np.maximum(1.0 - np.minimum(residual / scale, 1.0) ** 2, 0.0) ** 2
        weights = np.maximum(weights, LEAST_WEIGHT)
        smooth = _local_parabolas(x, weights, offsets, kernel)
    return smooth


def _local_parabolas(x: Array, weights: Array, offsets: Array, kernel: Array) -> Array:
    """Return the values (K,), at each sample, of the weighted parabola around it.

    The normal equations of all samples are convolutions: their matrix has the moments
    S_m = Σ k(u) w u^m, m = 0…4, and their right side Σ k(u) w x u^m, m = 0…2. Beyond the ends
    there are no samples, and their weight is 0.
    """
    powers = kernel * offsets ** np.arange(5)[:, None]
    flipped = powers[:, ::-1]  # a convolution turns its kernel around
    moments = oaconvolve(np.tile(weights, (5, 1)), flipped, mode="same", axes=1)
    right = oaconvolve(np.tile(weights * x, (3, 1)), flipped[:3], mode="same", axes=1)
    s0, s1, s2, s3, s4 = moments
    # Cramer's rule for the constant term: cofactors of the matrix's first row
    c0, c1, c2 = s2 * s4 - s3**2, s2 * s3 - s1 * s4, s1 * s3 - s2**2
    numerator = right[0] * c0 + right[1] * c1 + right[2] * c2
    return np.asarray(numerator / (s0 * c0 + s1 * c1 + s2 * c2))
