"""Changes of a quantity over the nights of one arm, judged against its own scatter.

A night's value is x = μ + γ·(T − T̄) + g·h(t) + s·scale·e, where scale is the night's nominal
standard deviation, s the night-to-night scatter in units of it, and h a change: a step from one
night on, or a drift. Nights with one motion share a further random term, since estimates depend on
the motion. The variance s² of an arm is regarded as drawn from a distribution over all arms, whose
parameters are estimated from medians (Smyth, Statistical Applications in Genetics and Molecular
Biology 3, 2004, with robust moments): arms that have changed do not enlarge the scatter of the
others, and the statistic of a change has a t distribution even after few nights. The p-value of
the strongest change is corrected for the number of nights at which it could begin (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma, stdtr
from scipy.stats import betabinom, chi2, f, median_abs_deviation

from lieid_casadi.arrays import Array, Indices, Mask

FEWEST_NIGHTS = 4  # of an arm that is judged
BASELINE_NIGHTS = 2  # at least, before a step
JUDGED_WITHOUT_NIGHT = 0.05  # p-value of a change from which on it is not tried without a night
CONFIDENCE = 0.95  # of the interval of a slope
FEWEST_FREEDOM, MOST_FREEDOM = 4.0, 15.0  # of the prior of the scatter
LEAST_SCATTER = 0.3  # in units of the nominal standard deviation
LEAST_TEMPERATURE_RANGE = 0.5  # °C
#: Variance between motions relative to that between nights, before it is estimated, the number
#: of pairs of nights that this counts as, and the largest value.
EXPECTED_BETWEEN, KNOWN_PAIRS, MOST_BETWEEN = 1.0, 5, 20.0
#: The same for slow variations, their correlation time, and the distance of nights from which
#: they are estimated.
EXPECTED_SLOW, MOST_SLOW, SLOW_DAYS, FAR_NIGHTS = 0.5, 20.0, 5.0, 6


#: Nights that a judgement uses: the latest ones, and at most so many of those before them, evenly
#: spaced. Its cost therefore does not grow with the age of an arm.
LATEST_NIGHTS, EARLIER_NIGHTS = 60, 40


@dataclass(frozen=True, eq=False)
class NightSeries:
    """A quantity of one arm over its nights."""

    days: Array  # (N,) number of each night, increasing
    values: Array  # (N,)
    scales: Array  # (N,) nominal standard deviations
    temperature: Array  # (N,) °C; NaN where it is not recorded
    motions: Indices  # (N,) equal for nights with the same motion and payload

    def __len__(self) -> int:
        return len(self.days)

    def at(self, nights: slice | Indices) -> NightSeries:
        """Return some of the nights."""
        return NightSeries(*(signal[nights] for signal in vars(self).values()))

    @property
    def latest(self) -> NightSeries:
        """The nights between which none is left out."""
        return self.at(slice(-LATEST_NIGHTS, None))

    def at_mean_temperature(self, slope: float) -> NightSeries:
        """Return the series without the dependence on temperature, slope in scales per °C."""
        warmer = self.temperature - self.temperature.mean()
        return replace(self, values=self.values - slope * np.median(self.scales) * warmer)

    @property
    def has_temperature(self) -> bool:
        """Whether temperatures of all nights are recorded, and vary."""
        t = self.temperature
        return bool(np.isfinite(t).all() and len(t) and np.ptp(t) >= LEAST_TEMPERATURE_RANGE)


def used_nights(count: int) -> Indices:
    """Return the positions, of so many nights, of those that a judgement uses."""
    earlier = max(count - LATEST_NIGHTS, 0)
    step = max(-(-earlier // EARLIER_NIGHTS), 1)
    return np.concatenate([np.arange(0, earlier, step), np.arange(earlier, count)])


@dataclass(frozen=True)
class ScatterPrior:
    """Distribution of the scatter's variance over arms."""

    variance: float  # s0², of nights with one motion, in units of the nominal variance
    freedom: float  # its degrees of freedom
    between: float = 0.0  # relative variance between motions
    slow: float = 0.0  # of what varies slowly, such as a temperature that is not recorded


@dataclass(frozen=True)
class TemperaturePrior:
    """Slope over temperature, in nominal standard deviations per °C, and its spread over arms."""

    slope: float
    spread: float
    variance: float = 0.0  # that the recorded temperatures cause, in nominal variances


def scatter_prior(
    series: Sequence[NightSeries], *, expected_slow: float = EXPECTED_SLOW
) -> ScatterPrior:
    """Return the distribution of the scatter's variance over series of comparable quantities."""
    slow = _slow_part(series, min(expected_slow, MOST_SLOW))
    nights = ScatterPrior(1.0, FEWEST_FREEDOM, _between_motions(series), slow)
    pairs = [_own_variance(each, nights) for each in series if len(each) >= 3]
    if not pairs:
        return nights
    variances, freedoms = np.array(pairs).T
    variances = np.maximum(variances, 1e-12)
    half = 0.5 * freedoms
    shifted = np.log(variances) - digamma(half) + np.log(half)
    spread = float(median_abs_deviation(shifted, scale="normal")) ** 2
    excess = spread - float(np.mean(polygamma(1, half)))
    freedom = FEWEST_FREEDOM
    if len(pairs) >= 5:
        freedom = MOST_FREEDOM if excess <= 0.0 else _inverse_trigamma(excess)
    freedom = float(np.clip(freedom, FEWEST_FREEDOM, MOST_FREEDOM))
    typical = float(np.median(variances * freedoms / chi2.median(freedoms)))
    return replace(nights, variance=max(typical, LEAST_SCATTER**2), freedom=freedom)


def whitening(series: NightSeries, prior: ScatterPrior) -> Array:
    """Return the matrix (N, N) that makes nights, in nominal standard deviations, independent."""
    return _whitening(series.days.tobytes(), series.motions.tobytes(), prior.between, prior.slow)


@lru_cache(maxsize=32)
def _whitening(day_bytes: bytes, motion_bytes: bytes, between: float, slow: float) -> Array:
    """Return the matrix of `whitening`; the quantities of one arm share it."""
    days, motions = np.frombuffer(day_bytes), np.frombuffer(motion_bytes, dtype=np.intp)
    covariance = np.eye(len(days)) + between * (motions[:, None] == motions)
    covariance += slow * np.exp(-np.abs(days[:, None] - days) / SLOW_DAYS)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def _between_motions(series: Sequence[NightSeries]) -> float:
    """Return the variance between motions relative to that between nights with one motion."""
    latest = [whole.latest for whole in series]
    differences = np.concatenate([np.diff(s.values) / np.median(s.scales) for s in latest]) ** 2
    same = np.concatenate([np.diff(s.motions) == 0 for s in latest])
    within, across = differences[same], differences[~same]
    if len(within) < KNOWN_PAIRS or not len(across):
        return 0.0  # one motion, or one per night, whose variance is in that between nights
    ratio = float(np.median(across)) / max(float(np.median(within)), 1e-12) - 1.0
    ratio = float(np.clip(ratio, 0.0, MOST_BETWEEN))
    return (len(across) * ratio + KNOWN_PAIRS * EXPECTED_BETWEEN) / (len(across) + KNOWN_PAIRS)


def temperature_prior(series: Sequence[NightSeries]) -> TemperaturePrior | None:
    """Return the slope over temperature of comparable series; None without temperatures.

    The series are of one joint of arms of one kind. Slopes are estimated from differences of
    successive nights, on which a change has little influence.
    """
    slopes, errors = [], []
    for each in (whole.latest for whole in series):
        if len(each) < 3 or not each.has_temperature:
            continue
        x = np.diff(each.values) / np.median(each.scales)
        warmer = np.diff(each.temperature)
        total = float(warmer @ warmer)
        slopes.append(float(warmer @ x) / total)
        errors.append(float(np.sqrt(np.mean((x - slopes[-1] * warmer) ** 2) / total)))
    if not slopes:
        return None
    middle = float(np.median(slopes))
    spread = float(max(median_abs_deviation(slopes, scale="normal"), np.median(errors), 1e-9))
    recorded = np.concatenate([each.temperature for each in series if each.has_temperature])
    return TemperaturePrior(middle, spread, middle**2 * float(np.var(recorded)))


def _slow_part(series: Sequence[NightSeries], expected: float) -> float:
    """Return the relative variance of what varies slowly, from differences over 1 and 6 nights."""
    values = [s.values / np.median(s.scales) for s in (whole.latest for whole in series)]
    near = np.concatenate([np.diff(x) for x in values]) ** 2
    far = np.concatenate([x[FAR_NIGHTS:] - x[:-FAR_NIGHTS] for x in values]) ** 2
    if not len(near):
        return expected
    at_near, at_far = 1.0 - np.exp(-1.0 / SLOW_DAYS), 1.0 - np.exp(-FAR_NIGHTS / SLOW_DAYS)
    ratio = float(np.median(far)) / max(float(np.median(near)), 1e-12) if len(far) else 1.0
    rest = at_far - at_near * ratio
    slow = MOST_SLOW if rest <= 0.0 else float(np.clip((ratio - 1.0) / rest, 0.0, MOST_SLOW))
    return (len(far) * slow + KNOWN_PAIRS * expected) / (len(far) + KNOWN_PAIRS)


def _own_variance(series: NightSeries, prior: ScatterPrior) -> tuple[float, float]:
    """Return variance around the mean, in scales, and its degrees of freedom."""
    columns = [1.0 / series.scales]
    if series.has_temperature and len(series) >= 5:
        columns.append((series.temperature - series.temperature.mean()) / series.scales)
    white = whitening(series, prior)
    matrix, target = white @ np.column_stack(columns), white @ (series.values / series.scales)
    rest = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
    freedom = len(series) - len(columns)
    return float(rest @ rest) / freedom, float(freedom)


def _inverse_trigamma(value: float) -> float:
    """Return d for which trigamma(d/2) is the value."""
    return float(
        2.0 * brentq(lambda half: float(polygamma(1, half)) - value, 1e-3, 1e4)
        if polygamma(1, 1e4) < value < polygamma(1, 1e-3)
        else 2e4
    )


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

    def days_of_limit(self, last_day: float, limit: float) -> list[float | None]:
        """Return the days when a drift reaches a limit of the value's size; None for never."""
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
    """Return the most significant step or drift; None for fewer than four nights."""
    count = len(series)
    if count < FEWEST_NIGHTS:
        return None
    white = whitening(series, prior) / series.scales
    known, target = _known_columns(series, white, prior, temperature)
    kinds, firsts, shapes = _shapes(series.days.tobytes())
    columns = np.zeros((len(target), len(kinds)))
    columns[:count] = white @ shapes
    basis, triangle = np.linalg.qr(known)
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
    tail = float(stdtr(freedom, -statistic[best] if rises_only else -abs(statistic[best])))
    p_value = min(1.0, (1.0 if rises_only else 2.0) * tail * len(kinds))
    coefficient = projected[best] / norm[best] if usable[best] else 0.0
    error = scatter[best] / norm[best] if usable[best] else np.inf
    drift, at_end = kinds[best] == "drift", shapes[-1, best]
    level = np.linalg.solve(triangle, basis.T @ (target - coefficient * columns[:, best]))[0]
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
    )


def _p_without_night(
    white: Array, prior: ScatterPrior, basis: Array, rest: Array, shape: Array
) -> float:
    """Return the largest p-value of a change if one of the nights since it (a column) is free."""
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
    return float(min(1.0, 2.0 * stdtr(freedom, -statistic.min())))


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
    """Return the columns (R, c) of level and temperature, and the values (R,), in scales."""
    level, target = white.sum(axis=1), white @ series.values
    if temperature is None or not series.has_temperature:
        return level[:, None], target
    typical = float(np.median(series.scales))
    warmer = white @ (series.temperature - series.temperature.mean()) * typical
    weight = np.sqrt(prior.variance) / temperature.spread
    columns = np.column_stack([level, warmer])
    return (np.vstack([columns, [0.0, weight]]), np.append(target, weight * temperature.slope))


@lru_cache(maxsize=32)
def _shapes(day_bytes: bytes) -> tuple[Array, Indices, Array]:
    """Return kind, first changed night and shape (N, k) of all changes that are tested."""
    days = np.frombuffer(day_bytes)
    count = len(days)
    steps, starts = np.arange(BASELINE_NIGHTS, count), np.arange(count - 2)
    step_shapes = (np.arange(count)[:, None] >= steps).astype(float)
    drift_shapes = np.maximum(days[:, None] - days[starts], 0.0)
    kinds = np.array(["step"] * len(steps) + ["drift"] * len(starts))
    return kinds, np.concatenate([steps, starts + 1]), np.hstack([step_shapes, drift_shapes])


#: Nights that the rate of the other arms counts as: rates of arms are alike, or differ freely.
RATE_WEIGHTS = (20.0, 1.0)


def repeated_finding(found: Mask, rate: float) -> tuple[float, int]:
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
