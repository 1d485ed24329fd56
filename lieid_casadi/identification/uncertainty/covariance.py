"""Covariance of least-squares values with residuals correlated in time and between joints.

Neighbouring low-passed residuals are strongly correlated, so that the formula for white noise
gives standard deviations several times too small. The covariance of the scores is estimated
twice:

- from the spectrum of the residuals, assumed to be stationary; precise, since only one spectrum
  per pair of joints is estimated. The autocovariance is estimated from all pairs of instants of
  one segment and truncated by a flat-top window where the correlogram is no longer significant
  (Politis & Romano, J. Time Series Analysis 1995; the rule for the cut-off is that of Politis &
  White, Econometric Reviews 2004);
- from the scores x·e themselves (Newey & West, Econometrica 1987, with Parzen's kernel), which
  is valid for residuals that are larger in some motions than in others, and has more variance.

Each parameter gets the larger standard deviation of the two; correlations are those of the
first. Both are corrected for the part of the noise that the fit has absorbed.

Limits: recordings must be many times longer than the correlation time of the residual; errors in
q are not accounted for; model errors are treated as noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.identification.regression.design_matrix import Design, rows_per_independent
from lieid_casadi.identification.regression.fixed_point import FitState
from lieid_casadi.identification.regression.least_squares import (
    WEAK,
    JointRows,
    Rows,
    solve,
    stacked,
)
from lieid_casadi.identification.regression.priors import known_before, with_rows
from lieid_casadi.identification.regression.variable_projection import shape_columns

QUIET = 5  # consecutive lags without significant correlation that end the correlation
SIGNIFICANT = 2.0  # times √(log₁₀N/N): threshold of significant correlation
LONGEST = 2000  # lags


@dataclass(frozen=True, eq=False)
class TimeLine:
    """All segments on one time axis, with gaps longer than any lag that is used."""

    positions: Indices  # (instants,) int: of each instant on the axis
    size: int  # length of the Fourier transforms
    longest: int  # largest lag that can be estimated

    @classmethod
    def of(cls, rows: Rows) -> TimeLine:
        """Return the time line of a regression's instants."""
        lengths = np.diff(rows.segments)
        longest = int(max(min(lengths.max(initial=1) // 2, LONGEST), 1))
        shifts = np.repeat(np.arange(len(lengths)) * longest, lengths)
        positions = np.arange(int(rows.segments[-1])) + shifts
        total = int(rows.segments[-1]) + len(lengths) * longest
        return cls(positions, next_fast_len(total + 1, real=True), longest)

    def transform(self, instants: Indices, values: Array) -> NDArray[np.complex128]:
        """Return the Fourier transform (F, …) of values (R, …) at given instants, else zero."""
        placed = np.zeros((self.size, *values.shape[1:]))
        placed[self.positions[instants]] = values
        return np.asarray(rfft(placed, axis=0))

    def back(self, instants: Indices, spectrum: NDArray[np.complex128]) -> Array:
        """Return the values at given instants of a Fourier transform."""
        return np.asarray(irfft(spectrum, self.size, axis=0)[self.positions[instants]])


@dataclass(frozen=True, eq=False)
class ResidualSpectrum:
    """Spectrum of the joints' residuals."""

    #: (F, n, n): complex: Hermitian and positive semidefinite at each frequency
    density: NDArray[np.complex128]
    variance: Array  # (n,): of each joint's residual
    correlation_length: int  # number of lags in which residuals are correlated
    window: Array  # (size,): window on the lags

    def smoothed(self, line: TimeLine, joint: JointRows, power: Array) -> Array:
        """Return a density (F,) from a periodogram (F,), smoothed as that of the residuals."""
        covariance = irfft(power, line.size) / _pairs(line, joint, joint)
        return np.asarray(rfft(self.window * covariance).real)


def residual_spectrum(line: TimeLine, rows: Rows, residuals: Sequence[Array]) -> ResidualSpectrum:
    """Return the spectrum of residuals."""
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


COLUMNS = 8  # transformed at once; bounds the memory of long recordings
LEAST_SPECTRUM = 0.1  # of a residual's spectrum that no number of parameters absorbs
NEGLIGIBLE = 1e-4  # of the kernel's maximum; frequencies below it are left out


def hac_covariance(
    rows: Rows, weights: Sequence[Array], residuals: Sequence[Array], unit_covariance: Array
) -> Array:
    """Return the covariance of least-squares values (p, p)."""
    line = TimeLine.of(rows)
    noise = [w**2 * e for w, e in zip(weights, residuals, strict=True)]
    spectrum = residual_spectrum(line, rows, noise)
    correction = _absorption_correction(line, rows, spectrum, weights, unit_covariance)
    size = np.sqrt(correction)
    raised = spectrum.density * (size[:, :, None] * size[:, None, :])
    scores = [
        line.back(joint.instant, correction[:, j] * line.transform(joint.instant, noise[j]))
        for j, joint in enumerate(rows.joints)
    ]
    axes = square_root(unit_covariance)
    stationary, general = (
        axes @ square_root(axes.T @ products @ axes)
        for products in (
            _filtered_products(line, rows, raised),
            _score_products(line, rows, scores, spectrum.correlation_length),
        )
    )
    first, second = (np.linalg.norm(half, axis=1) for half in (stationary, general))
    ratio = np.divide(second, first, out=np.ones_like(first), where=first > 0.0)
    half = stationary * np.maximum(ratio, 1.0)[:, None]
    return np.asarray(half @ half.T)


def residual_correlation_length(rows: Rows, residuals: Sequence[Array]) -> int:
    """Return the number of instants over which residuals (R,) per joint are correlated."""
    return residual_spectrum(TimeLine.of(rows), rows, residuals).correlation_length


def _filtered_products(line: TimeLine, rows: Rows, density: NDArray[np.complex128]) -> Array:
    """Return Σ_jk X_jᵀ·Ω_jk·X_k (p, p), Ω having the covariances of a spectrum (F, n, n)."""
    total = np.zeros((rows.count, rows.count))
    for first in range(0, rows.count, COLUMNS):
        block = np.arange(first, min(first + COLUMNS, rows.count))
        given = np.stack([_transform_columns(line, joint, block) for joint in rows.joints], axis=1)
        filtered = np.einsum("fjk,fkc->fjc", density, given)
        for k, joint in enumerate(rows.joints):
            values = line.back(joint.instant, filtered[:, k])
            total[np.ix_(joint.columns, block)] += joint.matrix.T @ values
    return 0.5 * (total + total.T)


def _transform_columns(line: TimeLine, joint: JointRows, block: Indices) -> NDArray[np.complex128]:
    """Return the transforms (F, c) of some base columns along one joint's rows."""
    values = np.zeros((len(joint.instant), len(block)))
    own, position = np.nonzero(joint.columns[:, None] == block[None, :])
    values[:, position] = joint.matrix[:, own]
    return line.transform(joint.instant, values)


def _absorption_correction(
    line: TimeLine,
    rows: Rows,
    spectrum: ResidualSpectrum,
    weights: Sequence[Array],
    unit_covariance: Array,
) -> Array:
    """Return the ratio of the noise's spectrum to the residual's (F, n) per frequency and joint.

    A fit absorbs noise at the frequencies of its columns, which are mostly low. The spectrum of
    the residual is that of (1 − H)Ω(1 − H)ᵀ, evaluated with the estimated Ω; correlation between
    joints is neglected.
    """
    own = [spectrum.density[:, j, j].real for j in range(len(rows.joints))]
    squares = [float(np.mean(w**2)) if len(w) else 1.0 for w in weights]
    middle = np.zeros_like(unit_covariance)
    for joint, density in zip(rows.joints, own, strict=True):
        small = joint.matrix.T @ _filtered(line, joint, density)
        middle[np.ix_(joint.columns, joint.columns)] += small
    axes = square_root(unit_covariance)
    half = axes @ square_root(axes.T @ middle @ axes)
    covariance = half @ half.T
    ratio = np.ones((line.size // 2 + 1, len(rows.joints)))
    for j, (joint, density, square) in enumerate(zip(rows.joints, own, squares, strict=True)):
        if spectrum.variance[j] <= 0.0:
            continue
        here = np.ix_(joint.columns, joint.columns)
        # in units of w²·e, whose columns are w²·X
        fitted = square * joint.matrix @ unit_covariance[here]
        power = -2.0 * _cross_power(line, joint, fitted, _filtered(line, joint, density))
        both = joint.matrix @ covariance[here] * square**2
        power += _cross_power(line, joint, both, joint.matrix)
        expected = density + spectrum.smoothed(line, joint, power)
        ratio[:, j] = density / np.maximum(
            expected, LEAST_SPECTRUM * density + np.finfo(float).tiny
        )
    return np.asarray(np.maximum(ratio, 1.0))


def _filtered(line: TimeLine, joint: JointRows, density: Array) -> Array:
    """Return Ω·X of one joint (R, c)."""
    filtered = np.empty_like(joint.matrix)
    for first in range(0, filtered.shape[1], COLUMNS):
        part = slice(first, first + COLUMNS)
        given = line.transform(joint.instant, joint.matrix[:, part])
        filtered[:, part] = line.back(joint.instant, density[:, None] * given)
    return filtered


def _cross_power(line: TimeLine, joint: JointRows, a: Array, b: Array) -> Array:
    """Return Σ over columns of the product of two transforms (F,), its real part."""
    total = np.zeros(line.size // 2 + 1)
    for first in range(0, a.shape[1], COLUMNS):
        part = slice(first, first + COLUMNS)
        one, other = (line.transform(joint.instant, x[:, part]) for x in (a, b))
        total += np.real(np.conj(one) * other).sum(axis=1)
    return total


def _score_products(line: TimeLine, rows: Rows, noise: Sequence[Array], lags: int) -> Array:
    """Return the scores' covariance summed over lags (p, p), with Parzen's kernel of 2·lags."""
    scores = np.zeros((int(rows.segments[-1]), rows.count))
    for joint, e in zip(rows.joints, noise, strict=True):
        # each instant occurs at most once per joint
        scores[np.ix_(joint.instant, joint.columns)] += joint.matrix * e[:, None]
    kernel = _parzen(line.size, 2 * lags)
    used = np.flatnonzero(kernel > NEGLIGIBLE * kernel.max())
    total = np.zeros((rows.count, rows.count))
    everywhere = np.arange(len(scores), dtype=np.intp)
    spectra = [
        line.transform(everywhere, scores[:, first : first + COLUMNS])[used]
        for first in range(0, rows.count, COLUMNS)
    ]
    spectrum = np.hstack(spectra)
    # every frequency but 0 and the highest is counted twice, for its negative
    both = np.where((used == 0) | (2 * used == line.size), 1.0, 2.0)
    total = np.real((np.conj(spectrum) * (both * kernel[used])[:, None]).T @ spectrum)
    return np.asarray(total / line.size)


def _parzen(size: int, lags: int) -> Array:
    """Return the spectrum (F,) of Parzen's window, which is not negative."""
    lag = np.arange(size)
    x = np.minimum(lag, size - lag) / max(lags, 1)
    near, far = 1.0 - 6.0 * x**2 + 6.0 * x**3, 2.0 * np.clip(1.0 - x, 0.0, None) ** 3
    return np.asarray(rfft(np.where(x < 0.5, near, far)).real)


def fit_covariance(design: Design, state: FitState, *, with_priors: bool) -> Array:
    """Return the covariance of values and shapes (p + s, p + s), of a fit with priors or not."""
    rows, values = state.rows, state.solution.values
    residuals, unit = rows.residuals(values), state.solution.unit_covariance
    if len(state.shapes):
        slopes = shape_columns(design, values, state.shapes, state.parameters)
        rows = with_columns(rows, slopes)
    factor = stacked(rows, state.weighting.rows)
    known = known_before(factor, design, of_effects=False) if with_priors else factor.r[:0]
    if len(state.shapes):
        unit = solve(with_rows(factor, design, known)).unit_covariance
    half = rows_per_independent(design.segments[0]) * unit @ known[:, :-1].T
    return hac_covariance(rows, state.weighting.rows, residuals, unit) + half @ half.T


def with_columns(rows: Rows, further: Sequence[Array]) -> Rows:
    """Return rows with further columns after the p base columns."""
    count = rows.count + further[0].shape[1]
    joints = tuple(
        JointRows(
            np.concatenate([joint.columns, np.arange(rows.count, count)]),
            np.column_stack([joint.matrix, extra]),
            joint.torque,
            joint.instant,
        )
        for joint, extra in zip(rows.joints, further, strict=True)
    )
    return Rows(joints, count, rows.segments)


FREE = 100.0  # standard deviations by which a weak parameter may move in place of one
EXACT = 1e-12  # variance relative to the largest below which a direction is known exactly
LEAST_KNOWN = 1e-8  # the same as a prior of later data: errors of a model do not average out


def prior_rows(covariance: Array, *, known: float = EXACT) -> Array:
    """Return rows R (p, p) whose square is the inverse of a covariance, which may be singular.

    Directions with less than the part ``known`` of the largest variance have that much.
    """
    unit, sizes, axes = scaled_axes(covariance)
    least = known * max(float(sizes.max(initial=0.0)), EXACT)
    return np.asarray((axes / np.sqrt(np.maximum(sizes, least))).T / unit)


def with_weak_free(covariance: Array) -> Array:
    """Return a covariance (p, p) in which weak parameters may have any value.

    Errors of a model do not average out along the little that other columns leave of theirs.
    """
    variance = np.diag(covariance)
    weak = variance * np.sum(prior_rows(covariance) ** 2, axis=0) > WEAK**-2
    along = FREE * covariance[:, weak] / np.sqrt(variance[weak])
    return np.asarray(covariance + along @ along.T)


def square_root(covariance: Array) -> Array:
    """Return H (p, p), C = H·Hᵀ: products with H are accurate where sums alone are known well."""
    unit, sizes, axes = scaled_axes(np.nan_to_num(covariance))
    return np.asarray(unit[:, None] * axes * np.sqrt(np.maximum(sizes, 0.0)))


def scaled_axes(covariance: Array) -> tuple[Array, Array, Array]:
    """Return units (p,), and variances (p,) and axes (p, p) in these units, smallest first."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(size > 0.0, size, 1.0)
    return unit, *np.linalg.eigh(covariance / np.outer(unit, unit))
