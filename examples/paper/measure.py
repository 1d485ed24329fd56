"""Errors per joint as in the paper's tables, their uncertainty, and errors in motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from lieid_casadi.identification import Fit
from lieid_casadi.recording import Processed, Processing, Recording, period_noise

Array = NDArray[np.float64]
BLOCK = 1.0  # s, length of the blocks of the bootstrap, longer than residuals are correlated
DRAWS = 1000  # of the bootstrap
QUANTILES = (0.025, 0.975)


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of a fit on recordings, per joint.

    Attributes
    ----------
    rms, correlation : (n,)
        RMS error, N·m, and correlation coefficient of all samples.
    moving : (n,)
        RMS error, N·m, of samples at least one period of the cut-off away from standstill (rest
        and reversals), where dry friction is undetermined.
    left_out : (n,)
        Fraction of the samples that ``moving`` leaves out.
    slow, fast : (n,)
        RMS error, N·m, of the slowest fifth of the samples and of the others.
    time : (K,)
        s.
    measured, predicted : (K, n)
        Torque, N·m.
    """

    rms: Array
    correlation: Array
    moving: Array
    left_out: Array
    slow: Array
    fast: Array
    time: Array
    measured: Array
    predicted: Array

    @property
    def total(self) -> float:
        """Sum of the RMS errors over the joints, as in the paper's last column."""
        return float(self.rms.sum())


def errors(fit: Fit, segments: Sequence[Processed]) -> Errors:
    """Compare a fit with processed recordings."""
    parts = []
    for segment in segments:
        assert segment.tau is not None
        step = segment.filtered_time[1] - segment.filtered_time[0]
        reach = int(np.ceil(1.0 / segment.cutoff / step))
        speed = np.abs(segment.dq[segment.kept])
        away = np.column_stack(
            [
                binary_erosion(row, np.ones(2 * reach + 1, dtype=bool), border_value=1)
                for row in (speed > segment.dead_zone).T
            ]
        )
        torque = segment.filter(segment.tau)
        parts.append((segment.filtered_time, torque, fit.predict_processed(segment), away, speed))
    time, measured, predicted, away, speed = (np.concatenate(x) for x in zip(*parts, strict=True))
    error = measured - predicted
    slowest = speed <= np.quantile(speed, 0.2, axis=0)
    return Errors(
        rms=np.sqrt(np.mean(error**2, axis=0)),
        correlation=np.array(
            [np.corrcoef(a, b)[0, 1] for a, b in zip(measured.T, predicted.T, strict=True)]
        ),
        moving=np.array([_rms(error[m, j]) for j, m in enumerate(away.T)]),
        left_out=1.0 - away.mean(axis=0),
        slow=np.array([_rms(error[m, j]) for j, m in enumerate(slowest.T)]),
        fast=np.array([_rms(error[~m, j]) for j, m in enumerate(slowest.T)]),
        time=time,
        measured=measured,
        predicted=predicted,
    )


@dataclass(frozen=True, eq=False)
class Difference:
    """RMS error of one model minus that of another on the same samples.

    Attributes
    ----------
    joints : (n,)
        N·m.
    interval : (2, n)
        95 % confidence interval, by a block bootstrap over time.
    total : float
        Sum over the joints, N·m.
    total_interval : tuple of float
    """

    joints: Array
    interval: Array
    total: float
    total_interval: tuple[float, float]

    @property
    def smaller(self) -> NDArray[np.intp]:
        """Joints (from 0) with a significantly smaller error."""
        return np.flatnonzero(self.interval[1] < 0.0)

    @property
    def larger(self) -> NDArray[np.intp]:
        """Joints (from 0) with a significantly larger error."""
        return np.flatnonzero(self.interval[0] > 0.0)

    @property
    def all_smaller(self) -> bool | None:
        """Whether the error is smaller on all joints; None if that is not significant."""
        if len(self.larger):
            return False
        return True if len(self.smaller) == len(self.joints) else None

    @property
    def total_smaller(self) -> bool | None:
        """Whether the sum of errors is smaller; None if that is not significant."""
        return _sign(*self.total_interval)


def difference(one: Errors, other: Errors) -> Difference:
    """Return the difference of the RMS errors of two fits on the same recordings."""
    square = [(e.measured - e.predicted) ** 2 for e in (one, other)]
    step = one.time[1] - one.time[0]
    size = max(1, round(BLOCK / step))
    count = len(one.time) // size
    # mean squares of blocks, (2, blocks, n)
    blocks = np.array([x[: count * size].reshape(count, size, -1).mean(axis=1) for x in square])
    drawn = np.random.default_rng(0).integers(count, size=(DRAWS, count))
    rms = np.sqrt(blocks[:, drawn].mean(axis=2))  # (2, draws, n)
    change = rms[0] - rms[1]
    return Difference(
        joints=one.rms - other.rms,
        interval=np.quantile(change, QUANTILES, axis=0),
        total=one.total - other.total,
        total_interval=_pair(np.quantile(change.sum(axis=1), QUANTILES)),
    )


def smaller(one: Array, other: Array) -> bool | None:
    """Return whether errors (P,) have a smaller RMS than others (P,); None if not significant.

    By a bootstrap over the points, which are taken as independent.
    """
    drawn = np.random.default_rng(0).integers(len(one), size=(DRAWS, len(one)))
    square = np.mean(one[drawn] ** 2 - other[drawn] ** 2, axis=1)
    return _sign(*_pair(np.quantile(square, QUANTILES)))


def _sign(low: float, high: float) -> bool | None:
    return True if high < 0.0 else False if low > 0.0 else None


def _pair(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def noise(recording: Recording, processing: Processing) -> Array:
    """Return the low-passed noise of the torque from period to period (n,), N·m.

    NaN for a recording that is not periodic.
    """
    found = period_noise(recording, cutoff=processing.cutoff)
    if found is None:
        return np.full(recording.n, np.nan)
    return found


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
