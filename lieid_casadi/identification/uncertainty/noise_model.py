"""Noise of filtered residuals: decimated instants and an autoregressive model.

Low-passed residuals at the rate of a fit are strongly correlated from row to row, and tests that
treat them as independent find every candidate significant. Rows are decimated to twice the
cut-off; the correlation of the noise itself is described by an autoregression.

Rows where dry friction is uncertain get less weight: the sign of a velocity within its noise of
zero, or within half a sample of a reversal, is not determined, and at rest friction has any value
up to its level. Model errors depend on the motion, noise does not: `Noise.motion_ratio`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.optimize import brentq
from scipy.signal import oaconvolve
from scipy.special import erf
from scipy.stats import chi2

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.compiled import Compiled
from lieid_casadi.identification.regression.fixed_point import FitState
from lieid_casadi.identification.regression.least_squares import unit_columns
from lieid_casadi.identification.regression.segment_columns import effect_signals
from lieid_casadi.recording.filtering import lowpass
from lieid_casadi.recording.processed import Processed

RATE_OVER_CUTOFF = 2.0
LARGEST_ORDER = 8
ROWS_PER_LAG = 25  # of the autoregression; with fewer rows its order is lower
SMALLEST_NOISE = 1e-12
LAGS = 50
LEAST_SPREAD = 0.1  # of the residual: friction uncertainty never explains all of it


@dataclass(frozen=True, eq=False)
class Runs:
    """Instants of one joint for statistical tests, in runs without gaps or rests."""

    #: positions (L,) in the common time line of all filtered segments, run by run
    at: tuple[Indices, ...]
    #: (N,): torque uncertainty from dry friction at each of them, N·m; see `friction_torque_std`
    friction_std: Array

    @property
    def count(self) -> int:
        """Number of instants."""
        return sum(len(run) for run in self.at)

    @property
    def all(self) -> Indices:
        """All instants, run after run."""
        return np.concatenate(self.at) if self.at else np.zeros(0, dtype=np.intp)

    def weights(self, spread: float) -> Array:
        """Return weights (N,) that give all rows the standard deviation ``spread``, N·m."""
        return np.asarray(spread / np.hypot(spread, self.friction_std))


def runs_of(usable: Mask, segments: Sequence[Processed], friction_std: Array) -> tuple[Runs, ...]:
    """Return the runs of each joint: decimated instants among the usable ones."""
    decimated, first = [], 0
    for segment in segments:
        count = len(segment.filtered_time)
        decimated.append(np.arange(first, first + count, row_step(segment)))
        first += count
    return tuple(
        _runs(own, decimated, std) for own, std in zip(usable.T, friction_std.T, strict=True)
    )


def _runs(usable: Mask, decimated: Sequence[Indices], friction_std: Array) -> Runs:
    runs: list[Indices] = []
    for instants in decimated:
        breaks = np.flatnonzero(np.diff(usable[instants].astype(int))) + 1
        runs += [p for p in np.split(instants, breaks) if len(p) and usable[p[0]]]
    at = np.concatenate(runs) if runs else np.zeros(0, dtype=np.intp)
    return Runs(tuple(runs), friction_std[at])


def row_step(segment: Processed) -> int:
    """Return the step of rows at twice the cut-off."""
    time = segment.filtered_time
    rate = 1.0 / (time[1] - time[0]) if len(time) > 1 else 1.0
    return max(1, int(rate / (RATE_OVER_CUTOFF * segment.cutoff)))


@dataclass(frozen=True, eq=False)
class Noise:
    """One joint's noise: an autoregression e_k = −Σ a_i·e_{k−i} + σ·white."""

    filter: Array  # (p + 1,): 1, a_1 … a_p
    sigma: float  # standard deviation of the white part, N·m
    spread: float  # of e itself, N·m
    #: estimated ratio of model errors on other motion to ``spread``, at least 1
    motion_ratio: float = 1.0

    @classmethod
    def white(cls, sigma: float) -> Noise:
        """Return white noise with standard deviation ``sigma``, N·m."""
        size = max(sigma, SMALLEST_NOISE)
        return cls(np.ones(1), size, size)

    @property
    def order(self) -> int:
        """Number of lags p."""
        return len(self.filter) - 1

    def variances(self, columns: Array) -> tuple[Array, Array]:
        """Return the variances (k,) of products of columns (R, k) with white noise, and with it.

        Both are of the same size; the unit is arbitrary.
        """
        length = next_fast_len(2 * len(columns), real=True)
        density = np.abs(np.fft.rfft(self.filter, length)) ** -2
        spectrum = np.abs(rfft(columns, length, axis=0)) ** 2
        return spectrum.sum(axis=0), density @ spectrum / density.mean()

    def times(self, factor: float) -> Noise:
        """Return noise with the same correlation, larger by a factor."""
        return replace(self, sigma=factor * self.sigma, spread=factor * self.spread)


def residual_noise(
    compiled: Compiled, segments: Sequence[Processed], state: FitState
) -> tuple[Noise, ...]:
    """Return the noise model of each joint's residual."""
    line = state.rows.on_time_line(state.solution.values)
    friction_std = [
        friction_torque_std(compiled, s, state.shapes, state.parameters) for s in segments
    ]
    runs = runs_of(np.isfinite(line), segments, np.concatenate(friction_std))
    links = state.parameters[: 10 * compiled.n]
    common = np.concatenate([common_effect_columns(compiled, s, links) for s in segments])
    block = round(BLOCK * RATE_OVER_CUTOFF * segments[0].cutoff) * row_step(segments[0])
    found = []
    for own, run, columns in zip(line.T, runs, np.moveaxis(common, 1, 0), strict=True):
        at = run.all
        residual = own[at]
        noise = noise_of(residual, run)
        weights = run.weights(noise.spread)
        ratio = motion_ratio_of(residual, weights, at, redundancy_of(noise), max(block, 1))
        part = explainable(weights * residual, weights[:, None] * columns[at])
        found.append(replace(noise, motion_ratio=ratio / float(np.sqrt(1.0 - part))))
    return tuple(found)


def redundancy_of(noise: Noise) -> float:
    """Return the number of decimated rows per independent square of a joint's noise."""
    response = np.zeros(LAGS)
    for k in range(LAGS):
        past = noise.filter[1 : k + 1] @ response[k - 1 :: -1][: noise.order] if k else 0.0
        response[k] = (k == 0) - past
    covariance = np.correlate(response, response, "full")[LAGS - 1 :]
    return 1.0 + 2.0 * float(np.sum((covariance[1:] / covariance[0]) ** 2))


def noise_of(residual: Array, runs: Runs) -> Noise:
    """Fit an autoregression to a joint's residual; its order minimizes the AIC."""
    spread = spread_of(residual, runs.friction_std)
    highest = min(LARGEST_ORDER, runs.count // ROWS_PER_LAG)
    lagged, now = _lags(residual * runs.weights(spread), runs, highest)
    if not len(now):
        return Noise.white(spread)
    found = []
    for order in range(highest + 1):
        past = lagged[:, :order]
        a = np.linalg.lstsq(past, now, rcond=None)[0] if order else np.zeros(0)
        variance = max(float(np.mean((now - past @ a) ** 2)), SMALLEST_NOISE**2)
        noise = Noise(np.concatenate([[1.0], -a]), float(np.sqrt(variance)), spread)
        found.append((len(now) * np.log(variance) + 2.0 * order, noise))
    return min(found, key=lambda one: one[0])[1]


def spread_of(residual: Array, friction_std: Array) -> float:
    """Return the standard deviation σ of residuals without the uncertainty of dry friction, N·m.

    It solves mean(e² / (σ² + s²)) = 1, with s the torque uncertainty from dry friction.
    """
    total = float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0
    if total <= SMALLEST_NOISE:
        return SMALLEST_NOISE

    def excess(sigma: float) -> float:
        return float(np.mean(residual**2 / (sigma**2 + friction_std**2))) - 1.0

    least = LEAST_SPREAD * total
    return float(brentq(excess, least, 2.0 * total)) if excess(least) > 0.0 else least


def _lags(residual: Array, runs: Runs, order: int) -> tuple[Array, Array]:
    """Return the ``order`` preceding values (N', order) of each value (N',) within its run."""
    past, now, first = [], [], 0
    for run in runs.at:
        values = residual[first : first + len(run)]
        first += len(run)
        if len(run) > order:
            windows = np.lib.stride_tricks.sliding_window_view(values, order + 1)
            past.append(windows[:, :-1][:, ::-1])
            now.append(windows[:, -1])
    if not now:
        return np.zeros((0, order)), np.zeros(0)
    return np.concatenate(past), np.concatenate(now)


REST_VARIANCE = 1.0 / 3.0  # of a uniform distribution from −1 to 1
REVERSAL = 1e-9  # rad/s, on either side of a reversal
RESPONSE = 2.0  # periods of the cut-off, length of the filter's impulse response


def friction_torque_std(
    compiled: Compiled, segment: Processed, shapes: Array, parameters: Array
) -> Array:
    """Return the standard deviation (M, n) of filtered torque due to dry friction, N·m."""
    reach = min(round(RESPONSE * segment.rate / segment.cutoff), len(segment) - 1)
    impulse = np.zeros(2 * reach + 1)
    impulse[reach] = 1.0
    response = lowpass(impulse, segment.rate, segment.cutoff)
    level = dry_level(compiled, segment, shapes, parameters)
    variance = np.where(segment.moving, 1.0 - expected_sign(segment) ** 2, 0.0) * level**2
    spread = oaconvolve(variance, response[:, None] ** 2, mode="same", axes=0)[segment.kept]
    rest = segment.filter(np.where(segment.moving, 0.0, level))
    return np.sqrt(np.maximum(spread, 0.0) + REST_VARIANCE * rest**2)


def expected_sign(segment: Processed) -> Array:
    """Return the expected sign of the velocity (K, n), −1 to 1.

    Torque and position are synchronous to half a sample at best.
    """
    ahead = 0.5 * np.abs(segment.ddq) / segment.rate
    return np.asarray(erf(3.0 / np.sqrt(2.0) * segment.dq / np.hypot(segment.dead_zone, ahead)))


def dry_level(compiled: Compiled, segment: Processed, shapes: Array, parameters: Array) -> Array:
    """Return half the jump of the effects' torque at a velocity reversal (K, n), N·m."""
    n, q = compiled.n, segment.q
    load = compiled.inverse_dynamics(q, segment.dq, segment.ddq, parameters[: 10 * n])
    signals: dict[str, Any] = effect_signals(segment, shapes, load) | {"dead_zone": None}
    still, coefficients = np.zeros_like(q), parameters[10 * n :]
    forward, back = (
        compiled.effect_torque(
            q, np.full_like(q, dq), still, coefficients, **signals, joint_effects_only=True
        )
        for dq in (REVERSAL, -REVERSAL)
    )
    return np.asarray(0.5 * np.abs(forward - back))


BLOCK = 2.0  # s
CERTAIN = 0.9  # weight above which dry friction adds less than half of the noise
FEWEST_ROWS = 8  # of a block whose mean square is used
LEVEL = 0.95  # of the test that blocks differ more than by chance
QUANTILE = 1.28  # standard deviations: one block in ten is above
SLOW = 0.1  # of the top speed
MOST_EXPLAINABLE = 0.9  # of the residual


def motion_ratio_of(
    residual: Array, weights: Array, at: Indices, redundancy: float, rows_per_block: int
) -> float:
    """Return the RMS residual that one tenth of the motion exceeds, relative to that of all of it.

    The variance of the blocks' mean squares counts by what exceeds the 95 % level of its χ²
    distribution under noise alone. The ratio is therefore 1 if blocks differ no more than by
    chance, and it grows from there without a jump.
    """
    sure = weights > CERTAIN
    residual, at = (weights * residual)[sure], at[sure]
    _, block, counts = np.unique(at // rows_per_block, return_inverse=True, return_counts=True)
    squares = np.bincount(block, weights=residual**2) / counts
    squares, counts = squares[counts >= FEWEST_ROWS], counts[counts >= FEWEST_ROWS]
    if len(squares) < 3 or not squares.any():
        return 1.0
    relative = squares / squares.mean()
    chance = float(np.mean(2.0 * redundancy / counts))
    most = chance * float(chi2.ppf(LEVEL, len(relative) - 1)) / (len(relative) - 1)
    variance = float(np.var(relative, ddof=1))
    return float(np.sqrt(1.0 + QUANTILE * np.sqrt(max(variance - most, 0.0))))


def explainable(residual: Array, columns: Array) -> float:
    """Return the part of a residual's variance that columns explain, adjusted for their number."""
    total = float(np.sum(residual**2))
    count, width = columns.shape
    if count < 3 * width or total == 0.0:
        return 0.0
    scaled, _ = unit_columns(columns)
    rest = residual - scaled @ np.linalg.lstsq(scaled, residual, rcond=1e-6)[0]
    part = 1.0 - float(np.sum(rest**2)) / total * count / (count - width)
    return float(np.clip(part, 0.0, MOST_EXPLAINABLE))


def common_effect_columns(compiled: Compiled, segment: Processed, links: Array) -> Array:
    """Return filtered columns (M, n, k) of common effects that depend on a joint's own motion."""
    top = np.maximum(np.abs(segment.dq).max(axis=0), 1e-9)
    q, dq, ddq = segment.q, segment.dq, segment.ddq
    x, load = dq / top, compiled.inverse_dynamics(q, dq, ddq, links)
    slow = np.sign(x) * np.exp(-((x / SLOW) ** 2))
    columns = [x * np.abs(x), x**3, slow, np.sign(x) * np.abs(load), ddq, np.sin(q), np.cos(q)]
    return segment.filter(np.stack(columns, axis=-1))
