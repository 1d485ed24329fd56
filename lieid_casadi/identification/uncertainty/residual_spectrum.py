"""Correlation of residuals in time and between joints, as a spectrum.

The autocovariance is estimated from all pairs of instants of one segment and truncated by a
flat-top window where the correlogram is no longer significant (Politis & Romano, J. Time Series
Analysis 1995; the rule for the cut-off is that of Politis & White, Econometric Reviews 2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from lieid_casadi.identification.regression.rows import JointRows, Rows

Array = NDArray[np.float64]
QUIET = 5  # consecutive lags without significant correlation that end the correlation
SIGNIFICANT = 2.0  # times √(log₁₀N/N): threshold of significant correlation
LONGEST = 2000  # lags


@dataclass(frozen=True, eq=False)
class TimeLine:
    """All segments on one time axis, with gaps longer than any lag that is used.

    Attributes
    ----------
    positions : (instants,) int
        Of each instant on the axis.
    size : int
        Length of the Fourier transforms.
    longest : int
        Largest lag that can be estimated.
    """

    positions: NDArray[np.intp]
    size: int
    longest: int

    @classmethod
    def of(cls, rows: Rows) -> TimeLine:
        """Return the time line of a regression's instants."""
        lengths = np.diff(rows.segments)
        longest = int(max(min(lengths.max(initial=1) // 2, LONGEST), 1))
        shifts = np.repeat(np.arange(len(lengths)) * longest, lengths)
        positions = np.arange(int(rows.segments[-1])) + shifts
        total = int(rows.segments[-1]) + len(lengths) * longest
        return cls(positions, next_fast_len(total + 1, real=True), longest)

    def transform(self, instants: NDArray[np.intp], values: Array) -> NDArray[np.complex128]:
        """Return the Fourier transform (F, …) of values (R, …) at given instants, else zero."""
        placed = np.zeros((self.size, *values.shape[1:]))
        placed[self.positions[instants]] = values
        return np.asarray(rfft(placed, axis=0))

    def back(self, instants: NDArray[np.intp], spectrum: NDArray[np.complex128]) -> Array:
        """Return the values at given instants of a Fourier transform."""
        return np.asarray(irfft(spectrum, self.size, axis=0)[self.positions[instants]])


@dataclass(frozen=True, eq=False)
class ResidualSpectrum:
    """Spectrum of the joints' residuals.

    Attributes
    ----------
    density : (F, n, n) complex
        Hermitian and positive semidefinite at each frequency.
    variance : (n,)
        Of each joint's residual.
    correlation_length : int
        Number of lags in which residuals are correlated.
    window : (size,)
        Window on the lags.
    """

    density: NDArray[np.complex128]
    variance: Array
    correlation_length: int
    window: Array

    def smoothed(self, line: TimeLine, joint: JointRows, power: Array) -> Array:
        """Return a density (F,) from a periodogram (F,), smoothed as that of the residuals.

        Parameters
        ----------
        line : TimeLine
        joint : JointRows
        power : (F,)
        """
        covariance = irfft(power, line.size) / _pairs(line, joint, joint)
        return np.asarray(rfft(self.window * covariance).real)


def residual_spectrum(line: TimeLine, rows: Rows, residuals: Sequence[Array]) -> ResidualSpectrum:
    """Return the spectrum of residuals.

    Parameters
    ----------
    line : TimeLine
    rows : Rows
    residuals : sequence of (R,)
        Per joint, at the instants of its rows.
    """
    n = len(rows.joints)
    series = [
        line.transform(joint.instant, e) for joint, e in zip(rows.joints, residuals, strict=True)
    ]

    def covariance(j: int, k: int) -> Array:
        product = irfft(np.conj(series[j]) * series[k], line.size)
        return np.asarray(product / _pairs(line, rows.joints[j], rows.joints[k]))

    own = [covariance(j, j) for j in range(n)]
    instants = int(rows.segments[-1])
    length = max((_correlation_length(c[: line.longest], instants) for c in own), default=1)
    lag = np.arange(line.size)
    window = np.clip(2.0 - np.minimum(lag, line.size - lag) / length, 0.0, 1.0)
    density = np.empty((line.size // 2 + 1, n, n), dtype=np.complex128)
    for j in range(n):
        for k in range(n):
            cut = window * (own[j] if j == k else covariance(j, k))
            density[:, j, k] = rfft(cut)
    variance = np.array([c[0] for c in own])
    return ResidualSpectrum(_positive(density), variance, length, window)


def _pairs(line: TimeLine, one: JointRows, other: JointRows) -> Array:
    """Return the number of pairs of instants with each lag (size,), at least 1."""
    there = [line.transform(j.instant, np.ones(len(j.instant))) for j in (one, other)]
    counts = irfft(np.conj(there[0]) * there[1], line.size)
    return np.asarray(np.maximum(np.round(counts), 1.0))


def _correlation_length(covariance: Array, instants: int) -> int:
    """Return the lag after which no correlation is significant."""
    if len(covariance) < 2 or covariance[0] <= 0.0:
        return 1
    chance = SIGNIFICANT * np.sqrt(np.log10(max(instants, 10)) / instants)
    quiet = np.abs(covariance[1:] / covariance[0]) < chance
    if len(quiet) < QUIET:
        return max(len(quiet), 1)
    run = np.convolve(quiet, np.ones(QUIET), "valid") == QUIET
    return int(np.argmax(run)) + 1 if run.any() else len(quiet)


def _positive(density: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the nearest spectrum that is positive semidefinite."""
    hermitian = 0.5 * (density + np.conj(np.swapaxes(density, 1, 2)))
    sizes, vectors = np.linalg.eigh(hermitian)
    scaled = vectors * np.maximum(sizes, 0.0)[:, None, :]
    return np.asarray(scaled @ np.conj(np.swapaxes(vectors, 1, 2)))
