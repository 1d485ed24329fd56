"""Blocks of time: held-out gains of columns, and rows whose errors count as independent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def time_blocks(
    segments: Sequence[Processed], noise: Sequence[Noise], runs: Sequence[Runs], duration: float
) -> Indices:
    """Return the block of time of each whitened row (R,); every segment begins a new block.

    Parameters
    ----------
    segments : sequence of Processed
    noise, runs : sequence
        Of each joint; they determine which instants have a whitened row.
    duration : float
        Of a block, s.
    """
    index, first = [], 0
    for segment in segments:
        time = segment.filtered_time
        index.append(first + ((time - time[0]) / duration).astype(np.intp))
        first = int(index[-1][-1]) + 1
    line = np.concatenate(index)
    return np.concatenate([line[n.instants(r)] for n, r in zip(noise, runs, strict=True)])


def cross_validated_gain(columns: Array, baseline: Baseline, folds: Indices) -> float:
    """Return the fall of the held-out sum of squares when columns are added, of all folds.

    Parameters
    ----------
    columns : (…, k)
        On the rows of the joints, whitened.
    baseline : Baseline
        Of R rows.
    folds : (…,) int
        Fold of each row of the joints; rows of a prior are in none.
    """
    return float(gains_of_folds(columns, baseline, folds).sum())


def gains_of_folds(columns: Array, baseline: Baseline, folds: Indices) -> Array:
    """Return the fall of the sum of squares of each fold (F,) when columns are added.

    The coefficients for a fold are those of the other folds; the model's own columns are
    projected out of all of them once.

    Parameters
    ----------
    columns : (…, k)
        On the rows of the joints, whitened.
    baseline : Baseline
        Of R rows.
    folds : (…,) int
        Fold of each row of the joints; rows of a prior are in none.
    """
    rest = baseline.project_out(baseline.padded(columns))
    folds = np.pad(folds, (0, len(rest) - len(folds)), constant_values=-1)
    gains = []
    for fold in np.unique(folds[folds >= 0]):
        held = folds == fold
        values = np.linalg.lstsq(rest[~held], baseline.residual[~held], rcond=None)[0]
        after = baseline.residual[held] - rest[held] @ values
        gains.append(float(np.sum(baseline.residual[held] ** 2) - np.sum(after**2)))
    return np.array(gains)
