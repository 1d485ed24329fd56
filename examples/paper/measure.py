"""Errors per joint, as the paper's tables have them and away from rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from lieid_casadi.identification import Fit
from lieid_casadi.recording import Processed, Processing, Recording, period_noise

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Errors:
    """Of a fit on recordings, (n,) each; N·m.

    ``rms`` and ``correlation`` are of all samples; ``moving`` is the RMS of samples at least one
    period of the cut-off away from standstill (rest and reversals), where dry friction can be
    anything, and ``left_out`` the fraction of the others. ``slow`` is the RMS of the slowest
    fifth of all samples, ``fast`` that of the rest.
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
        """Sum over the joints, as the paper's last column."""
        return float(self.rms.sum())


def errors(fit: Fit, segments: Sequence[Processed]) -> Errors:
    """Compare a fit with recordings as `process` returns them."""
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


def noise(recording: Recording, processing: Processing) -> Array:
    """Return what noise leaves through the filters (n,), N·m; NaN where nothing repeats."""
    found = period_noise(recording, cutoff=processing.cutoff)
    if found is None:
        return np.full(recording.n, np.nan)
    return found


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
