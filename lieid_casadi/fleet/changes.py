"""Changes of a quantity over the nights of one arm, judged against its own scatter.

A night's value is x = μ + γ·(T − T̄) + g·h(t) + s·scale·e, where scale is the night's nominal
standard deviation, s the night-to-night scatter in units of it, and h a change: a step from one
night on, or a drift. Nights with one motion share a further random term, since estimates depend on
the motion. The arm's variance s² is combined with its distribution over all arms, so
that the statistic of a change has a t distribution even after few nights. The p-value of the
strongest change is corrected for the number of nights at which it could begin (Bonferroni).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import betabinom, f
from scipy.stats import t as student

from lieid_casadi.arrays import Array
from lieid_casadi.fleet.scatter import NightSeries, ScatterPrior, TemperaturePrior, whitening

FEWEST_NIGHTS = 4  # of an arm that is judged
BASELINE_NIGHTS = 2  # at least, before a step
JUDGED_WITHOUT_NIGHT = 0.05  # p-value of a change from which on it is not tried without a night
CONFIDENCE = 0.95  # of the interval of a slope


@dataclass(frozen=True, eq=False)
class Change:
    """The strongest change of a series."""

    kind: str  # ``step`` or ``drift``
    first: int  # position of the first changed night
    size: float  # at the last night
    std: float
    slope: float  # of a drift, per day, with bounds of 95 % confidence; otherwise 0
    slope_low: float
    slope_high: float
    level: float  # value before the change, at the mean temperature
    scatter: float  # standard deviation of one night
    p_value: float  # two-sided, corrected for all possible beginnings
    #: Largest p-value of this change, not corrected, if one of the nights since its beginning is
    #: left out; 1 if there is only one, or if ``p_value`` is 0.05 or more.
    p_without_night: float
    freedom: float  # degrees of freedom of its t statistic

    def days_of_limit(self, last_day: float, limit: float) -> list[float | None]:
        """Return the days when a drift reaches a limit of the value's size; None for never.

        They belong to the slope, to the steepest one of its interval, and to the flattest.
        """
        ends = sorted((self.slope_low, self.slope_high), key=lambda s: -s * self.slope)
        bound, now = np.sign(self.slope) * limit, self.level + self.size
        return [
            last_day + max(float(bound - now) / slope, 0.0) if slope * self.slope > 0.0 else None
            for slope in (self.slope, *ends)
        ]


def strongest_change(
    series: NightSeries,
    prior: ScatterPrior,
    temperature: TemperaturePrior | None = None,
    *,
    rises_only: bool = False,
) -> Change | None:
    """Return the most significant step or drift; None for fewer than four nights.

    Without a prior of its slope the temperature is not a covariate.
    """
    count = len(series)
    if count < FEWEST_NIGHTS:
        return None
    white = whitening(series, prior) / series.scales
    known, target = _known_columns(series, white, prior, temperature)
    kinds, firsts, shapes = _shapes(series.days)
    columns = np.zeros((len(target), len(kinds)))
    columns[:count] = white @ shapes
    basis = np.linalg.qr(known)[0]
    rest = target - basis @ (basis.T @ target)
    outside = columns - basis @ (basis.T @ columns)
    norm = np.sqrt(np.sum(outside**2, axis=0))
    usable = norm > 1e-9 * np.linalg.norm(columns, axis=0)
    projected = np.where(usable, rest @ outside / np.where(usable, norm, 1.0), 0.0)
    misfit = np.maximum(rest @ rest - projected**2, 0.0)
    freedom = prior.freedom + len(target) - known.shape[1] - 1
    scatter = np.sqrt((prior.freedom * prior.variance + misfit) / freedom)
    statistic = projected / scatter
    best = int(np.argmax(statistic if rises_only else np.abs(statistic)))
    tail = float(student.sf(statistic[best] if rises_only else abs(statistic[best]), freedom))
    p_value = min(1.0, (1.0 if rises_only else 2.0) * tail * len(kinds))
    coefficient = projected[best] / norm[best] if usable[best] else 0.0
    error = scatter[best] / norm[best] if usable[best] else np.inf
    drift, at_end = kinds[best] == "drift", shapes[-1, best]
    level = np.linalg.lstsq(known, target - coefficient * columns[:, best], rcond=None)[0][0]
    interval = (0.0, 0.0)
    if drift:
        of_drift = (kinds == "drift") & usable
        most = misfit[best] + scatter[best] ** 2 * 2.0 * float(f.ppf(CONFIDENCE, 2, freedom))
        interval = _slopes(projected[of_drift], norm[of_drift], misfit[of_drift], most)
    return Change(
        str(kinds[best]),
        int(firsts[best]),
        float(coefficient * at_end),
        float(error * at_end),
        float(coefficient) if drift else 0.0,
        *interval,
        float(level),
        float(scatter[best] * np.sqrt(1.0 + prior.between + prior.slow) * np.median(series.scales)),
        p_value,
        _p_without_night(white[:, firsts[best] :], prior, basis, rest, outside[:, best])
        if p_value < JUDGED_WITHOUT_NIGHT
        else 1.0,
        float(freedom),
    )


def _p_without_night(
    white: Array, prior: ScatterPrior, basis: Array, rest: Array, shape: Array
) -> float:
    """Return the largest p-value of a change if one of the nights since its beginning is left out.

    A night is left out by a free term of its own, a column of ``white`` (N, k). ``rest`` and
    ``shape`` (R,) are values and change without the known columns, whose basis is (R, c).
    """
    nights = np.zeros((len(rest), white.shape[1]))
    nights[: len(white)] = white
    nights -= basis @ (basis.T @ nights)
    nights /= np.maximum(np.linalg.norm(nights, axis=0), 1e-300)
    others = shape[:, None] - nights * (shape @ nights)
    norm = np.linalg.norm(others, axis=0)
    if (norm <= 1e-9 * np.linalg.norm(shape)).any():
        return 1.0
    projected = rest @ others / norm
    projected *= np.sign(rest @ shape)  # a change in the other direction is none
    misfit = np.maximum(rest @ rest - (rest @ nights) ** 2 - projected**2, 0.0)
    freedom = prior.freedom + len(rest) - basis.shape[1] - 2
    statistic = projected / np.sqrt((prior.freedom * prior.variance + misfit) / freedom)
    return float(min(1.0, 2.0 * student.sf(statistic.min(), freedom)))


def _slopes(projected: Array, norm: Array, misfit: Array, most: float) -> tuple[float, float]:
    """Return the range of slopes with a misfit up to ``most`` for at least one beginning.

    It is the projection of the common confidence region of slope and beginning. The arguments (k,)
    are, for a drift from each beginning, the projection of the values, the norm of the shape, and
    the sum of squares of the residual.
    """
    possible = misfit <= most
    middle = projected[possible] / norm[possible]
    half = np.sqrt(most - misfit[possible]) / norm[possible]
    return float(np.min(middle - half)), float(np.max(middle + half))


def _known_columns(
    series: NightSeries, white: Array, prior: ScatterPrior, temperature: TemperaturePrior | None
) -> tuple[Array, Array]:
    """Return the columns (R, c) of level and temperature, and the values (R,), in scales.

    The prior of the slope over temperature is one more row. ``white`` (N, N) makes nights
    independent, with unit nominal variance.
    """
    level, target = white.sum(axis=1), white @ series.values
    if temperature is None or not series.has_temperature:
        return level[:, None], target
    typical = float(np.median(series.scales))
    warmer = white @ (series.temperature - series.temperature.mean()) * typical
    weight = np.sqrt(prior.variance) / temperature.spread
    columns = np.column_stack([level, warmer])
    return (np.vstack([columns, [0.0, weight]]), np.append(target, weight * temperature.slope))


def _shapes(days: Array) -> tuple[Array, NDArray[np.intp], Array]:
    """Return kind, first changed night and shape (N, k) of all changes that are tested."""
    count = len(days)
    steps, starts = np.arange(BASELINE_NIGHTS, count), np.arange(count - 2)
    step_shapes = (np.arange(count)[:, None] >= steps).astype(float)
    drift_shapes = np.maximum(days[:, None] - days[starts], 0.0)
    kinds = np.array(["step"] * len(steps) + ["drift"] * len(starts))
    return kinds, np.concatenate([steps, starts + 1]), np.hstack([step_shapes, drift_shapes])


#: Nights that the rate of the other arms counts as: rates of arms are alike, or differ freely.
RATE_WEIGHTS = (20.0, 1.0)


def repeated_finding(found: NDArray[np.bool_], rate: float) -> tuple[float, int]:
    """Return the p-value that an effect is found more often since a night, and that night.

    The rate of an arm has a beta distribution around that of the other arms, which the nights
    before update; the number of findings since then has a beta-binomial distribution. The larger
    p-value of a narrow and of a wide beta distribution is taken. It is corrected for the number of
    beginnings. ``rate`` (above 0) is the part of the other arms' nights on which it was found.
    """
    best, first = 1.0, len(found) - 1
    for k in np.flatnonzero(found):
        if k < BASELINE_NIGHTS:
            continue
        own, after = int(found[:k].sum()), found[k:]
        counts = np.arange(after.sum(), len(after) + 1)
        p = len(found) * max(
            float(betabinom.pmf(counts, len(after), own + w * rate, k - own + w * (1 - rate)).sum())
            for w in RATE_WEIGHTS
        )
        if p < best:
            best, first = p, int(k)
    return min(best, 1.0), first
