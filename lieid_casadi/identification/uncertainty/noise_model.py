"""Noise of filtered residuals: decimated instants and an autoregressive model.

Low-passed residuals at the rate of a fit are strongly correlated from row to row, and tests that
treat them as independent find every candidate significant. Rows are decimated to twice the
cut-off, and the correlation of the noise itself is removed by an autoregressive filter on torque
and columns (Cochrane & Orcutt, JASA 1949). Rows where dry friction is uncertain get less weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from lieid_casadi.compiled import Compiled
from lieid_casadi.identification.regression.fixed_point import FitState
from lieid_casadi.identification.regression.friction_uncertainty import friction_torque_std
from lieid_casadi.identification.uncertainty.motion_dependence import (
    BLOCK,
    common_effect_columns,
    explainable,
    motion_ratio_of,
)
from lieid_casadi.recording.processed import Processed

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
RATE_OVER_CUTOFF = 2.0
LARGEST_ORDER = 8
ROWS_PER_LAG = 25  # of the autoregression; with fewer rows its order is lower
SMALLEST_NOISE = 1e-12
LEAST_FREEDOM = 0.1
LAGS = 50
LEAST_SPREAD = 0.1  # of the residual: friction uncertainty never explains all of it


@dataclass(frozen=True, eq=False)
class Runs:
    """Instants of one joint for statistical tests, in runs without gaps or rests.

    Attributes
    ----------
    at : tuple of (L,) int
        Positions in the common time line of all filtered segments, run by run.
    friction_std : (N,)
        Torque uncertainty from dry friction at each of them, N·m; see `friction_torque_std`.
    """

    at: tuple[Indices, ...]
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


def runs_of(
    usable: NDArray[np.bool_], segments: Sequence[Processed], friction_std: Array
) -> tuple[Runs, ...]:
    """Return the runs of each joint: decimated instants among the usable ones.

    Parameters
    ----------
    usable : (instants, n) bool
        On the common time line of all filtered segments.
    segments : sequence of Processed
    friction_std : (instants, n)
        Torque uncertainty from dry friction on that time line, N·m.
    """
    decimated, first = [], 0
    for segment in segments:
        count = len(segment.filtered_time)
        decimated.append(np.arange(first, first + count, _step(segment)))
        first += count
    return tuple(
        _runs(own, decimated, std) for own, std in zip(usable.T, friction_std.T, strict=True)
    )


def _runs(usable: NDArray[np.bool_], decimated: Sequence[Indices], friction_std: Array) -> Runs:
    runs: list[Indices] = []
    for instants in decimated:
        breaks = np.flatnonzero(np.diff(usable[instants].astype(int))) + 1
        runs += [p for p in np.split(instants, breaks) if len(p) and usable[p[0]]]
    at = np.concatenate(runs) if runs else np.zeros(0, dtype=np.intp)
    return Runs(tuple(runs), friction_std[at])


def _step(segment: Processed) -> int:
    time = segment.filtered_time
    rate = 1.0 / (time[1] - time[0]) if len(time) > 1 else 1.0
    return max(1, int(rate / (RATE_OVER_CUTOFF * segment.cutoff)))


@dataclass(frozen=True, eq=False)
class Noise:
    """One joint's noise: an autoregression e_k = −Σ a_i·e_{k−i} + σ·white.

    Attributes
    ----------
    filter : (p + 1,)
        1, a_1 … a_p.
    sigma, spread : float
        Of the white part, and of e itself, N·m.
    motion_ratio : float
        Estimated ratio of model errors on other motion to ``spread``, at least 1.
    """

    filter: Array
    sigma: float
    spread: float
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

    def times(self, factor: float) -> Noise:
        """Return noise with the same correlation, larger by a factor."""
        return replace(self, sigma=factor * self.sigma, spread=factor * self.spread)

    def whiten(self, values: Array, runs: Runs) -> Array:
        """Return weighted and whitened signals, whose noise has unit variance.

        Parameters
        ----------
        values : (N, …)
            Signals at the instants of the runs.
        runs : Runs

        Returns
        -------
        (N', …) ndarray
            Without the first p instants of each run, which initialize the filter.
        """
        weights = runs.weights(self.spread) / self.sigma
        weighted = values * weights.reshape(-1, *[1] * (values.ndim - 1))
        if self.order == 0:  # white noise: no row depends on others
            return np.asarray(weighted)
        parts, first = [np.zeros((0, *values.shape[1:]))], 0
        for run in runs.at:
            if len(run) > self.order:
                part = weighted[first : first + len(run)]
                parts.append(_convolved(part, self.filter))
            first += len(run)
        return np.concatenate(parts)

    def instants(self, runs: Runs) -> Indices:
        """Return the instants (N',) of the whitened rows."""
        parts = [run[self.order :] for run in runs.at if len(run) > self.order]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.intp)


def _convolved(signal: Array, taps: Array) -> Array:
    """Return Σ taps[i]·signal[k − i] for all k with enough preceding samples."""
    order = len(taps) - 1
    result = taps[0] * signal[order:]
    for lag in range(1, order + 1):
        result = result + taps[lag] * signal[order - lag : len(signal) - lag]
    return np.asarray(result)


def residual_noise(
    compiled: Compiled, segments: Sequence[Processed], state: FitState
) -> tuple[Noise, ...]:
    """Return the noise model of each joint's residual.

    Parameters
    ----------
    compiled : Compiled
    segments : sequence of Processed
        Of the training recordings.
    state : FitState
        Of the fit.
    """
    line = state.rows.on_time_line(state.solution.values)
    friction_std = [
        friction_torque_std(compiled, s, state.shapes, state.parameters) for s in segments
    ]
    runs = runs_of(np.isfinite(line), segments, np.concatenate(friction_std))
    links = state.parameters[: 10 * compiled.n]
    common = np.concatenate([common_effect_columns(compiled, s, links) for s in segments])
    block = round(BLOCK * RATE_OVER_CUTOFF * segments[0].cutoff) * _step(segments[0])
    found = []
    for own, run, columns in zip(line.T, runs, np.moveaxis(common, 1, 0), strict=True):
        at = run.all
        residual = own[at]
        noise = noise_of(residual, run)
        weights = run.weights(noise.spread)
        redundancy = 1.0 + 2.0 * float(np.sum(_correlations(noise) ** 2))
        ratio = motion_ratio_of(residual, weights, at, redundancy, max(block, 1))
        part = explainable(weights * residual, weights[:, None] * columns[at])
        found.append(replace(noise, motion_ratio=ratio / float(np.sqrt(1.0 - part))))
    return tuple(found)


def _correlations(noise: Noise) -> Array:
    """Return the autocorrelations (LAGS − 1,) of a joint's noise."""
    response = np.zeros(LAGS)
    for k in range(LAGS):
        past = noise.filter[1 : k + 1] @ response[k - 1 :: -1][: noise.order] if k else 0.0
        response[k] = (k == 0) - past
    covariance = np.correlate(response, response, "full")[LAGS - 1 :]
    return np.asarray(covariance[1:] / covariance[0])


def noise_of(residual: Array, runs: Runs, freedom: float = 1.0) -> Noise:
    """Fit an autoregression to a joint's residual; its order minimizes the AIC.

    Parameters
    ----------
    residual : (N,)
        At the instants of the runs, N·m.
    runs : Runs
    freedom : float
        Degrees of freedom of the residual per row, 0 to 1.
    """
    spread = spread_of(residual, runs.friction_std, freedom)
    highest = min(LARGEST_ORDER, runs.count // ROWS_PER_LAG)
    lagged, now = _lags(residual * runs.weights(spread), runs, highest)
    if not len(now):
        return Noise.white(spread)
    best: tuple[float, Noise] | None = None
    for order in range(highest + 1):
        past = lagged[:, :order]
        a = np.linalg.lstsq(past, now, rcond=None)[0] if order else np.zeros(0)
        variance = max(float(np.mean((now - past @ a) ** 2)), SMALLEST_NOISE**2)
        criterion = len(now) * np.log(variance) + 2.0 * order
        if best is None or criterion < best[0]:
            sigma = np.sqrt(variance / max(freedom, LEAST_FREEDOM))
            best = criterion, Noise(np.concatenate([[1.0], -a]), float(sigma), spread)
    assert best is not None
    return best[1]


def spread_of(residual: Array, friction_std: Array, freedom: float = 1.0) -> float:
    """Return the standard deviation σ of residuals without the uncertainty of dry friction, N·m.

    It solves mean(e² / (σ² + s²)) = freedom, with s the torque uncertainty from dry friction.

    Parameters
    ----------
    residual : (N,)
        N·m.
    friction_std : (N,)
        s, N·m.
    freedom : float
        Degrees of freedom of the residual per row, 0 to 1.
    """
    total = float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0
    if total <= SMALLEST_NOISE:
        return SMALLEST_NOISE
    freedom = max(freedom, LEAST_FREEDOM)

    def excess(sigma: float) -> float:
        return float(np.mean(residual**2 / (sigma**2 + friction_std**2))) - freedom

    least, most = LEAST_SPREAD * total, 2.0 * total / np.sqrt(freedom)
    return float(brentq(excess, least, most)) if excess(least) > 0.0 else least


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
