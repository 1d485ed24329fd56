"""Dependence of the residual on the motion: model errors depend on it, noise does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from lieid_casadi.compiled import Compiled
from lieid_casadi.recording.processed import Processed

Array = NDArray[np.float64]
BLOCK = 2.0  # s
CERTAIN = 0.9  # weight above which dry friction adds less than half of the noise
FEWEST_ROWS = 8  # of a block whose mean square is used
LEVEL = 0.95  # of the test that blocks differ more than by chance
QUANTILE = 1.28  # standard deviations: one block in ten is above
SLOW = 0.1  # of the top speed
MOST_EXPLAINABLE = 0.9  # of the residual


def motion_ratio_of(
    residual: Array,
    weights: Array,
    at: NDArray[np.intp],
    redundancy: float,
    rows_per_block: int,
) -> float:
    """Return the RMS residual that one tenth of the motion exceeds, relative to that of all of it.

    The variance of the blocks' mean squares counts by what exceeds the 95 % level of its χ²
    distribution under noise alone. The ratio is therefore 1 if blocks differ no more than by
    chance, and it grows from there without a jump.

    Parameters
    ----------
    residual : (N,)
        Of one joint.
    weights : (N,)
        Of its rows, 0 to 1. Those where dry friction is uncertain are left out: an uncertain sign
        of the velocity gives large errors near rests and reversals, which are not evenly spread
        over the motion.
    at : (N,) int
        Instants.
    redundancy : float
        Number of rows per independent sample, from the correlation of the residual.
    rows_per_block : int
        Instants per block.
    """
    sure = weights > CERTAIN
    residual, at = (weights * residual)[sure], at[sure]
    _, block, counts = np.unique(at // rows_per_block, return_inverse=True, return_counts=True)
    squares = np.bincount(block, weights=residual**2) / counts
    squares, counts = squares[counts >= FEWEST_ROWS], counts[counts >= FEWEST_ROWS]
    if len(squares) < 3 or not squares.any():
        return 1.0
    relative = squares / squares.mean()
    chance = float(np.mean(2.0 * redundancy / counts))
    most = chance * float(chi2.ppf(LEVEL, len(relative) - 1)) / (len(relative) - 1)
    variance = float(np.var(relative, ddof=1))
    return float(np.sqrt(1.0 + QUANTILE * np.sqrt(max(variance - most, 0.0))))


def explainable(residual: Array, columns: Array) -> float:
    """Return the part of the residual's variance that columns explain, adjusted for their number.

    Parameters
    ----------
    residual : (N,)
    columns : (N, k)
    """
    total = float(np.sum(residual**2))
    count, width = columns.shape
    if count < 3 * width or total == 0.0:
        return 0.0
    norms = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(norms > 0.0, norms, 1.0)
    rest = residual - scaled @ np.linalg.lstsq(scaled, residual, rcond=1e-6)[0]
    part = 1.0 - float(np.sum(rest**2)) / total * count / (count - width)
    return float(np.clip(part, 0.0, MOST_EXPLAINABLE))


def common_effect_columns(compiled: Compiled, segment: Processed, links: Array) -> Array:
    """Return filtered columns (M, n, k) of common effects that depend on a joint's own motion.

    Parameters
    ----------
    compiled : Compiled
    segment : Processed
        With M filtered instants.
    links : (10 n,)
        Link parameters.
    """
    top = np.maximum(np.abs(segment.dq).max(axis=0), 1e-9)
    parts = []
    for window in segment.windows:
        q, dq, ddq = (x[window.instants] for x in (segment.q, segment.dq, segment.ddq))
        x, load = dq / top, compiled.inverse_dynamics(q, dq, ddq, links)
        slow = np.sign(x) * np.exp(-((x / SLOW) ** 2))
        columns = [x * np.abs(x), x**3, slow, np.sign(x) * np.abs(load), ddq, np.sin(q), np.cos(q)]
        parts.append(segment.filter_window(np.stack(columns, axis=-1), window))
    return np.concatenate(parts)
