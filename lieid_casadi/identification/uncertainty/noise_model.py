"""The noise of filtered rows: thinned to independent instants, whitened by an autoregression.

Low-passed residuals at the rate of a fit are nearly the same number from row to row; a test that
counts them all finds everything significant. Thinned to twice the cut-off, little is lost, and
what memory the noise has of its own is removed by an autoregressive filter on torque and columns
alike (Cochrane, Orcutt, JASA 1949). Rows that dry friction leaves in doubt count for less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from lieid_casadi.compiled import Compiled
from lieid_casadi.identification.regression.fixed_point import State
from lieid_casadi.identification.regression.friction_uncertainty import doubt_along
from lieid_casadi.identification.uncertainty.model_error import (
    BLOCK,
    explainable,
    rise_of,
    simple_columns,
)
from lieid_casadi.recording.processing.process import Processed

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
RATE_OVER_CUTOFF = 2.0
LARGEST_ORDER = 8
ROWS_PER_LAG = 25  # of the autoregression: fewer rows than that make a shorter one
SMALLEST_NOISE = 1e-12
LEAST_FREEDOM = 0.1
LAGS = 50
LEAST_SPREAD = 0.1  # of the residual: all of it is never in doubt


@dataclass(frozen=True, eq=False)
class Runs:
    """One joint's instants for tests, in runs without a gap or a rest.

    Attributes
    ----------
    at : tuple of (L,) int
        Positions in the common time line of all filtered segments, run by run.
    doubt : (N,)
        Standard deviation that dry friction adds to each of them, N·m; see `doubt_along`.
    """

    at: tuple[Indices, ...]
    doubt: Array

    @property
    def count(self) -> int:
        """Number of instants."""
        return sum(len(run) for run in self.at)

    @property
    def all(self) -> Indices:
        """All instants, run after run."""
        return np.concatenate(self.at) if self.at else np.zeros(0, dtype=np.intp)

    def weights(self, spread: float) -> Array:
        """Return weights (N,) that make all rows as noisy as those without doubt."""
        return np.asarray(spread / np.hypot(spread, self.doubt))


def runs_of(
    usable: NDArray[np.bool_], segments: Sequence[Processed], doubt: Array
) -> tuple[Runs, ...]:
    """Return each joint's runs of thinned instants among the usable ones.

    Parameters
    ----------
    usable, doubt : (instants, n)
        On the common time line of all filtered segments.
    """
    thin, first = [], 0
    for segment in segments:
        count = len(segment.filtered_time)
        thin.append(np.arange(first, first + count, _step(segment)))
        first += count
    return tuple(_runs(own, thin, sure) for own, sure in zip(usable.T, doubt.T, strict=True))


def _runs(usable: NDArray[np.bool_], thin: Sequence[Indices], doubt: Array) -> Runs:
    runs: list[Indices] = []
    for instants in thin:
        breaks = np.flatnonzero(np.diff(usable[instants].astype(int))) + 1
        runs += [p for p in np.split(instants, breaks) if len(p) and usable[p[0]]]
    at = np.concatenate(runs) if runs else np.zeros(0, dtype=np.intp)
    return Runs(tuple(runs), doubt[at])


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
    rises : float
        How many times the spread errors of the model may reach on other motion.
    """

    filter: Array
    sigma: float
    spread: float
    rises: float = 1.0

    @classmethod
    def white(cls, sigma: float) -> Noise:
        """Return noise without memory."""
        size = max(sigma, SMALLEST_NOISE)
        return cls(np.ones(1), size, size)

    @property
    def order(self) -> int:
        """Number of lags p."""
        return len(self.filter) - 1

    def times(self, factor: float) -> Noise:
        """Return noise of the same colour, larger by a factor."""
        return replace(self, sigma=factor * self.sigma, spread=factor * self.spread)

    def whiten(self, values: Array, runs: Runs) -> Array:
        """Return signals (N, …) on a joint's runs, weighted and whitened, of unit noise.

        The first p instants of each run only start the filter and are left out.
        """
        weights = runs.weights(self.spread)
        weighted = values * weights.reshape(-1, *[1] * (values.ndim - 1))
        parts, first = [np.zeros((0, *values.shape[1:]))], 0
        for run in runs.at:
            if len(run) > self.order:
                part = weighted[first : first + len(run)]
                parts.append(_convolved(part, self.filter))
            first += len(run)
        return np.concatenate(parts) / self.sigma

    def instants(self, runs: Runs) -> Indices:
        """Return the instants of the whitened rows."""
        parts = [run[self.order :] for run in runs.at if len(run) > self.order]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.intp)


def _convolved(signal: Array, taps: Array) -> Array:
    """Return Σ taps[i]·signal[k − i] for the instants that have all predecessors."""
    order = len(taps) - 1
    result = taps[0] * signal[order:]
    for lag in range(1, order + 1):
        result = result + taps[lag] * signal[order - lag : len(signal) - lag]
    return np.asarray(result)


def residual_noise(
    compiled: Compiled, segments: Sequence[Processed], state: State
) -> tuple[Noise, ...]:
    """Return the noise of each joint's residual in a fit, and how it depends on the motion."""
    line = state.rows.on_time_line(state.solution.values)
    doubt = [doubt_along(compiled, s, state.shapes, state.parameters) for s in segments]
    runs = runs_of(np.isfinite(line), segments, np.concatenate(doubt))
    links = state.parameters[: 10 * compiled.n]
    simple = np.concatenate([simple_columns(compiled, s, links) for s in segments])
    block = round(BLOCK * RATE_OVER_CUTOFF * segments[0].cutoff) * _step(segments[0])
    found = []
    for own, run, columns in zip(line.T, runs, np.moveaxis(simple, 1, 0), strict=True):
        at = run.all
        residual = own[at]
        noise = noise_of(residual, run)
        weights = run.weights(noise.spread)
        memory = 1.0 + 2.0 * float(np.sum(_correlations(noise) ** 2))
        rise = rise_of(weights * residual, at, memory, max(block, 1))
        part = explainable(weights * residual, weights[:, None] * columns[at])
        found.append(replace(noise, rises=rise / float(np.sqrt(1.0 - part))))
    return tuple(found)


def _correlations(noise: Noise) -> Array:
    """Return the autocorrelations of a joint's noise at the first lags."""
    response = np.zeros(LAGS)
    for k in range(LAGS):
        past = noise.filter[1 : k + 1] @ response[k - 1 :: -1][: noise.order] if k else 0.0
        response[k] = (k == 0) - past
    covariance = np.correlate(response, response, "full")[LAGS - 1 :]
    return np.asarray(covariance[1:] / covariance[0])


def noise_of(residual: Array, runs: Runs, freedom: float = 1.0) -> Noise:
    """Fit an autoregression to a joint's residual (N,) on its runs; order by AIC.

    Parameters
    ----------
    freedom : float
        Part of the rows that parameters have not used up, 0 to 1.
    """
    spread = spread_of(residual, runs.doubt, freedom)
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


def spread_of(residual: Array, doubt: Array, freedom: float = 1.0) -> float:
    """Return the standard deviation of residuals (N,) beside what is in doubt (N,).

    It makes the mean of e² / (σ² + doubt²) the part ``freedom`` of one.
    """
    total = float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0
    if total <= SMALLEST_NOISE:
        return SMALLEST_NOISE
    freedom = max(freedom, LEAST_FREEDOM)

    def excess(sigma: float) -> float:
        return float(np.mean(residual**2 / (sigma**2 + doubt**2))) - freedom

    least, most = LEAST_SPREAD * total, 2.0 * total / np.sqrt(freedom)
    return float(brentq(excess, least, most)) if excess(least) > 0.0 else least


def _lags(residual: Array, runs: Runs, order: int) -> tuple[Array, Array]:
    """Return each instant's ``order`` predecessors (N, order) and the instants (N,)."""
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
