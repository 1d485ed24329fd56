"""The paper's filters (6.2): the mean of the periods, and RLOESS of acceleration and torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import oaconvolve

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RecordingError
from lieid_casadi.recording import Processed, Processing, Recording, detect_period, process
from lieid_casadi.recording.filtering import smooth_at, straight_at
from lieid_casadi.recording.measurement import OPTIONAL_SIGNALS


def paper_filtered(recording: Recording, cutoff: float) -> tuple[Processed, ...]:
    """Return the mean period below a cut-off, Hz, with smoothed acceleration and torque."""
    options = Processing(cutoff=cutoff)
    mean = mean_period(recording, options.trim)
    if mean.tau is not None:
        mean = replace(mean, tau=robust_loess(mean.t, mean.tau, cutoff))
    return tuple(replace(s, ddq=robust_loess(s.t, s.ddq, cutoff)) for s in process(mean, options))


def mean_period(recording: Recording, margin: float) -> Recording:
    """Return the mean over all full periods, continued by a margin, s, at both ends."""
    period = detect_period(recording)
    if period is None:
        raise RecordingError(
            f"{recording.title}: no period found, expected two full periods or "
            "more of the same motion"
        )
    count = max(8, round(period * recording.rate))
    step = period / count
    periods = int((recording.duration + 0.5 * step) // period)
    extra = min(count, int(np.ceil(margin / step)))
    order = np.arange(-extra, count + extra + 1)
    instants = recording.t[0] + np.arange(periods * count) * step
    instants = np.minimum(instants, recording.t[-1])
    means = {}
    for field in ("q", *OPTIONAL_SIGNALS):
        values = getattr(recording, field)
        if values is None:
            continue
        at = smooth_at if field in ("q", "dq", "ddq") else straight_at
        folded = at(recording.t, values, instants).reshape(periods, count, recording.n)
        means[field] = folded.mean(axis=0)[order % count]
    label = recording.payload_label
    return replace(
        recording,
        t=recording.t[0] + order * step,
        payload_label=None if label is None else (label[0],) * order.size,
        **means,
    )


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
    """Smooth signals x (K, n) at uniform instants over 1.5 periods of the cut-off.

    Each value is that of a parabola, fitted to the samples of the span around it with tricube
    weights (W. S. Cleveland, J. Am. Stat. Assoc. 74, 1979, with degree 2). The fit is repeated
    with bisquare weights of the residuals, so that outliers lose their weight, which no linear
    filter can do; for the same reason the smoothed torque has not gone through the columns'
    filter alone.
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
