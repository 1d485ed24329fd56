"""Error on data that a fit has not seen, without a test recording: blocked cross-validation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification.design import JointRows, Rows
from lieid_casadi.identification.least_squares import combine, joint_factors, solve

Array = NDArray[np.float64]
FOLDS = 3
BLOCK_OVER_CUTOFF = 12.0  # block length in periods of the cut-off: many times the filter's memory


def cross_validated_rms(rows: Rows, noise: Array, *, block: int) -> Array:
    """Return the RMS (n,) of each joint's held-out rows, N·m.

    Blocks of consecutive instants go to the folds in turn; each fold is predicted from the
    linear parameters of the others (weights, load and shape parameters are those of the whole
    fit). NaN for a joint without rows.

    Parameters
    ----------
    noise : (n,)
        Weights are 1/noise per joint.
    block : int
        Instants per block.
    """
    fold = _folds(rows, block)
    squares, counts = np.zeros(len(rows.joints)), np.zeros(len(rows.joints))
    for held in range(FOLDS):
        kept = _select(rows, fold != held)
        values = solve(combine(joint_factors(kept), 1.0 / noise)).values
        for j, error in enumerate(_select(rows, fold == held).residuals(values)):
            squares[j] += np.sum(error**2)
            counts[j] += len(error)
    return np.sqrt(np.divide(squares, counts, out=np.full_like(squares, np.nan), where=counts > 0))


def _folds(rows: Rows, block: int) -> NDArray[np.intp]:
    """Return each instant's fold; blocks start anew with each segment."""
    fold = np.empty(int(rows.segments[-1]), dtype=np.intp)
    first = 0
    for start, end in zip(rows.segments[:-1], rows.segments[1:], strict=True):
        blocks = first + np.arange(end - start) // block
        fold[start:end] = blocks % FOLDS
        first = int(blocks[-1]) + 1 if len(blocks) else first
    return fold


def _select(rows: Rows, instants: NDArray[np.bool_]) -> Rows:
    joints = []
    for joint in rows.joints:
        use = instants[joint.instant]
        joints.append(
            JointRows(joint.columns, joint.matrix[use], joint.torque[use], joint.instant[use])
        )
    return Rows(tuple(joints), rows.count, rows.segments)
