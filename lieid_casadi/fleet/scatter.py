"""Scatter and dependence on temperature of comparable quantities, pooled over the arms.

The variance of one arm is regarded as drawn from a distribution over all arms, whose parameters
are estimated from medians (Smyth, Statistical Applications in Genetics and Molecular Biology 3,
2004, with robust moments): arms that have changed do not enlarge the scatter of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import digamma, polygamma
from scipy.stats import chi2, median_abs_deviation

from lieid_casadi.arrays import Array

FEWEST_FREEDOM, MOST_FREEDOM = 4.0, 15.0  # of the prior of the scatter
LEAST_SCATTER = 0.3  # in units of the nominal standard deviation
MAD_TO_STD = 1.4826
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
    motions: NDArray[np.intp]  # (N,) equal for nights with the same motion and payload

    def __len__(self) -> int:
        return len(self.days)

    def at(self, nights: slice | NDArray[np.intp]) -> NightSeries:
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


def used_nights(count: int) -> NDArray[np.intp]:
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
    """Return the distribution of the scatter's variance over series of comparable quantities.

    ``expected_slow`` is the relative variance of slow variations before it is estimated.
    """
    slow = _slow_part(series, min(expected_slow, MOST_SLOW))
    nights = ScatterPrior(1.0, FEWEST_FREEDOM, _between_motions(series), slow)
    pairs = [_own_variance(each, nights) for each in series if len(each) >= 3]
    if not pairs:
        return nights
    variances, freedoms = np.array(pairs).T
    variances = np.maximum(variances, 1e-12)
    half = 0.5 * freedoms
    shifted = np.log(variances) - digamma(half) + np.log(half)
    spread = (MAD_TO_STD * float(median_abs_deviation(shifted))) ** 2
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
    """Return the variance between motions relative to that between nights with one motion.

    It follows from the differences of successive nights with and without a change of motion.
    """
    within: list[float] = []
    across: list[float] = []
    for each in (whole.latest for whole in series):
        differences = np.diff(each.values) / np.median(each.scales)
        same = np.diff(each.motions) == 0
        within += (differences[same] ** 2).tolist()
        across += (differences[~same] ** 2).tolist()
    if len(within) < KNOWN_PAIRS or not across:
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
    spread = max(MAD_TO_STD * float(median_abs_deviation(slopes)), float(np.median(errors)), 1e-9)
    recorded = np.concatenate([each.temperature for each in series if each.has_temperature])
    return TemperaturePrior(middle, spread, middle**2 * float(np.var(recorded)))


def _slow_part(series: Sequence[NightSeries], expected: float) -> float:
    """Return the relative variance of slow variations, from differences over one and more nights.

    The variance of a difference over k days is 2·σ²·(1 + slow·(1 − exp(−k/SLOW_DAYS))).
    """
    near: list[float] = []
    far: list[float] = []
    for each in (whole.latest for whole in series):
        x = each.values / np.median(each.scales)
        near += (np.diff(x) ** 2).tolist()
        far += ((x[FAR_NIGHTS:] - x[:-FAR_NIGHTS]) ** 2).tolist()
    if not near:
        return expected
    at_near, at_far = 1.0 - np.exp(-1.0 / SLOW_DAYS), 1.0 - np.exp(-FAR_NIGHTS / SLOW_DAYS)
    ratio = float(np.median(far)) / max(float(np.median(near)), 1e-12) if far else 1.0
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
