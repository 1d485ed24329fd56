"""Rows for tests: thinned to independent instants, and whitened by an autoregression.

Low-passed residuals at the rate of a fit are nearly the same number from row to row; a test that
counts them all finds everything significant. Thinned to twice the cut-off, little is lost, and
what memory the noise has of its own is removed by an autoregressive filter on torque and columns
alike (Cochrane, Orcutt, JASA 1949).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification.design import Rows
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
RATE_OVER_CUTOFF = 2.0
LARGEST_ORDER = 8
ROWS_PER_LAG = 25  # of the autoregression: fewer rows than that make a shorter one
SMALLEST_NOISE = 1e-12


@dataclass(frozen=True, eq=False)
class Runs:
    """One joint's instants for tests, in runs without a gap or a rest.

    ``at`` holds the positions in the common time line of all filtered segments.
    """

    at: tuple[Indices, ...]

    @property
    def count(self) -> int:
        """Number of instants."""
        return sum(len(run) for run in self.at)

    @property
    def all(self) -> Indices:
        """All instants, run after run."""
        return np.concatenate(self.at) if self.at else np.zeros(0, dtype=np.intp)


def runs_of(rows: Rows, segments: Sequence[Processed]) -> tuple[Runs, ...]:
    """Return each joint's runs of thinned instants that are among a fit's rows."""
    found = []
    for joint in rows.joints:
        usable = np.zeros(int(rows.segments[-1]), dtype=bool)
        usable[joint.instant] = True
        runs: list[Indices] = []
        for segment, start, end in zip(
            segments, rows.segments[:-1], rows.segments[1:], strict=True
        ):
            thin = np.arange(start, end, _step(segment))
            breaks = np.flatnonzero(np.diff(usable[thin].astype(int))) + 1
            runs += [part for part in np.split(thin, breaks) if len(part) and usable[part[0]]]
        found.append(Runs(tuple(runs)))
    return tuple(found)


def _step(segment: Processed) -> int:
    time = segment.filtered_time
    rate = 1.0 / (time[1] - time[0]) if len(time) > 1 else 1.0
    return max(1, int(rate / (RATE_OVER_CUTOFF * segment.cutoff)))


@dataclass(frozen=True, eq=False)
class Noise:
    """One joint's noise: an autoregression e_k = −Σ a_i·e_{k−i} + σ·white.

    ``filter`` is (1, a_1 … a_p).
    """

    filter: Array
    sigma: float

    @property
    def order(self) -> int:
        """Number of lags p."""
        return len(self.filter) - 1

    def whiten(self, values: Array, runs: Runs) -> Array:
        """Return signals (N, …) on a joint's runs, whitened, of unit noise.

        The first p instants of each run only start the filter and are left out.
        """
        parts, first = [np.zeros((0, *values.shape[1:]))], 0
        for run in runs.at:
            if len(run) > self.order:
                part = values[first : first + len(run)]
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


def noise_of(residual: Array, runs: Runs, freedom: float) -> Noise:
    """Fit an autoregression to a joint's residual (N,) on its runs; order by AIC.

    Parameters
    ----------
    freedom : float
        Part of the rows that parameters have not used up, 0 to 1.
    """
    highest = min(LARGEST_ORDER, runs.count // ROWS_PER_LAG)
    lagged, now = _lags(residual, runs, highest)
    if not len(now):
        return Noise(np.ones(1), max(float(np.std(residual)), SMALLEST_NOISE))
    best: tuple[float, Noise] | None = None
    for order in range(highest + 1):
        past = lagged[:, :order]
        a = np.linalg.lstsq(past, now, rcond=None)[0] if order else np.zeros(0)
        variance = max(float(np.mean((now - past @ a) ** 2)), SMALLEST_NOISE**2)
        criterion = len(now) * np.log(variance) + 2.0 * order
        if best is None or criterion < best[0]:
            sigma = np.sqrt(variance / max(freedom, 0.1))
            best = criterion, Noise(np.concatenate([[1.0], -a]), float(sigma))
    assert best is not None
    return best[1]


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
