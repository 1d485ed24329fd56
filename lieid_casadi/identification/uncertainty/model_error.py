"""How much a fit's misfit depends on the motion: noise does not, errors of the model do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from lieid_casadi.compiled import Compiled
from lieid_casadi.recording.processing.process import Processed

Array = NDArray[np.float64]
BLOCK = 2.0  # s
FEWEST = 8  # rows of a block whose size says something
SURE = 0.95  # level at which blocks differ more than chance has it
HIGH = 1.28  # standard deviations: one block in ten is above
SLOW = 0.1  # of the top speed
MOST = 0.9  # of the residual that is taken to be explainable


def rise_of(residual: Array, at: NDArray[np.intp], memory: float, rows_per_block: int) -> float:
    """Return the error of a bad stretch of motion over that of all, 1 where it is steady.

    Parameters
    ----------
    residual : (N,)
        Of one joint.
    at : (N,) int
        Instants, of which a block has ``rows_per_block``.
    memory : float
        Rows that count for one, by the residual's correlation.
    """
    _, block, counts = np.unique(at // rows_per_block, return_inverse=True, return_counts=True)
    squares = np.bincount(block, weights=residual**2) / counts
    squares, counts = squares[counts >= FEWEST], counts[counts >= FEWEST]
    if len(squares) < 3 or not squares.any():
        return 1.0
    relative = squares / squares.mean()
    chance = float(np.mean(2.0 * memory / counts))
    most = chance * float(chi2.ppf(SURE, len(relative) - 1)) / (len(relative) - 1)
    variance = float(np.var(relative, ddof=1))
    beyond = variance - chance if variance > most else 0.0
    return float(np.sqrt(1.0 + HIGH * np.sqrt(beyond)))


def explainable(residual: Array, columns: Array) -> float:
    """Return the part of a residual (N,) that columns (N, k) explain, less what chance does."""
    total = float(np.sum(residual**2))
    count, width = columns.shape
    if count < 3 * width or total == 0.0:
        return 0.0
    norms = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(norms > 0.0, norms, 1.0)
    rest = residual - scaled @ np.linalg.lstsq(scaled, residual, rcond=1e-6)[0]
    part = 1.0 - float(np.sum(rest**2)) / total * count / (count - width)
    return float(np.clip(part, 0.0, MOST))


def simple_columns(compiled: Compiled, segment: Processed, links: Array) -> Array:
    """Return filtered columns (M, n, k) of what arms lack most often, on each joint's own motion.

    Parameters
    ----------
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
