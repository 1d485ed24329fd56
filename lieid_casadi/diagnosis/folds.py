"""Held-out parts of the rows: contiguous stretches of time, with gaps around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr, stdtrit

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.step import LEAST_STRETCHES
from lieid_casadi.identification.uncertainty.noise_model import RATE_OVER_CUTOFF, Noise, noise_of
from lieid_casadi.recording.periods import detect_period

LEAST_OTHERS = 1e-3  # of what is expected of an effect, in the parts beside one
SMALLEST_TAIL = 1e-30  # probability of a deviation: the inverse of the distribution is finite


@dataclass(frozen=True, eq=False)
class Folds:
    """K held-out parts of the rows of all joints."""

    #: (K, R): rows of each part
    held: Mask
    #: (K, R): these, and the rows within ``gap`` seconds of them, with correlated noise
    out: Mask
    gap: float
    apart: bool  # whether that is all that noise needs: a short period has no rows for more
    #: (n,): stretches of the recordings, as long as the correlation of each joint's residual
    independent: Indices

    @property
    def count(self) -> int:
        """Number of parts."""
        return len(self.held)

    def deviations(self, gains: Array, expected: Array, joint: int) -> tuple[float, float]:
        """Return the mean gain (K,) of an effect in its standard errors, and how certain it is.

        An effect does not act equally in all parts. Its gains are therefore compared with those
        ``expected`` (K,) of what it changes there, by the ratio of the sums: parts where it does
        nothing are no doubt about it. Noise scatters with a variance proportional to what is
        expected; the standard error is unbiased then (Royall and Cumberland, Journal of the
        American Statistical Association 1981). Parts count as far as each has `LEAST_STRETCHES`
        that are independent. Of an effect in few parts the standard error is uncertain: the
        second number is the deviation that is as probable with equal parts (Student's
        distribution, degrees of freedom by Satterthwaite, Biometrics Bulletin 1946).
        """
        total = float(expected.sum())
        if total <= 0.0:
            return 0.0, 0.0
        others = np.maximum(1.0 - expected / total, LEAST_OTHERS)
        scatter = np.mean((gains - gains.sum() / total * expected) ** 2 / others)
        parts = np.clip(self.independent[joint] / LEAST_STRETCHES, 1.0, self.count)
        found = float(np.mean(gains) / max(np.sqrt(scatter / parts), 1e-12))
        freedom = self.count - 1.0  # with equal parts
        own = freedom / self.count * total**2 / float(np.sum(expected**2))
        tail = max(float(stdtr(own, -abs(found))), SMALLEST_TAIL)
        return found, float(np.sign(found) * -stdtrit(freedom, tail))


def folds_of(rows: Rows, residual: Sequence[Array], count: int) -> Folds:
    """Return the held-out parts of rows.

    A part is one stretch of the whole time in motion; of periodic motion it is a stretch of the
    period, in all periods, so that no motion is on both sides. The gap between parts follows from
    the correlation of the residual (R_j,) of each joint.
    """
    noise = [noise_of(r, run) for r, run in zip(residual, rows.runs, strict=True)]
    lasting = np.array([redundancy(each) for each in noise])
    correlated = lasting / (RATE_OVER_CUTOFF * rows.segments[0].cutoff)
    place = places(rows, count)
    whole = sum(float(s.filtered_time[-1] - s.filtered_time[0]) for s in rows.segments)
    needed = min(float(correlated.max()), whole / count)
    # at most a stretch: seven tenths of the rows remain
    gap = min(needed, whole / (1 + np.count_nonzero(np.diff(place))))
    held = [place == k for k in range(count)]
    out = [own | (_distance(rows.times, rows.times[own]) < gap) for own in held]
    at = np.concatenate([run.all for run in rows.runs])
    independent = (whole / correlated).astype(np.intp)
    return Folds(np.array(held)[:, at], np.array(out)[:, at], gap, gap >= needed, independent)


def redundancy(noise: Noise) -> float:
    """Return the rows per independent sample: long-run variance of a noise over its variance."""
    long_run = (noise.sigma / max(abs(float(noise.filter.sum())), 1e-3)) ** 2
    return max(long_run / noise.spread**2, 1.0)


def independent_spread(noise: Sequence[Noise]) -> Array:
    """Return the standard deviation (n,) of each joint's noise per independent sample, N·m."""
    return np.array([np.sqrt(redundancy(each)) * each.spread for each in noise])


def places(rows: Rows, count: int) -> Indices:
    """Return the part of each instant of the common time line; time at rest does not count.

    Where joints move one after the other, a part has several stretches, so that it does not have
    all that is known of a joint.
    """
    used = np.zeros(len(rows.times))
    for run in rows.runs:
        used[run.all] = 1.0
    place = (np.cumsum(used) - used) / max(float(used.sum()), 1.0)
    for k, pieces in enumerate(rows.pieces.values()):
        periods = (detect_period(rows.segments[piece].recording) for piece in pieces)
        if period := next(filter(None, periods), None):
            own = rows.recordings == k
            place[own] = rows.clock[own] % period / period
    numbers = [count * (k + 1) for k in range(len(rows.runs))]  # of stretches
    every = [np.minimum((m * place).astype(np.intp), m - 1) % count for m in numbers]
    moved = [run.all for run in rows.runs if run.count]
    least = [min((len(np.unique(p[own])) for own in moved), default=0) for p in every]
    return every[int(np.argmax(np.minimum(least, count // 2 + 1)))]  # the fewest stretches


def _distance(times: Array, others: Array) -> Array:
    """Return the distance of each time to the nearest of other sorted times."""
    if not len(others):
        return np.full(len(times), np.inf)
    after = np.searchsorted(others, times).clip(0, len(others) - 1)
    before = (after - 1).clip(0)
    return np.asarray(np.minimum(np.abs(times - others[after]), np.abs(times - others[before])))
