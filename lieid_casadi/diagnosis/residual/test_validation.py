"""Whether what training finds explainable is so on the test; what is not was chance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import (
    Unexplained,
    ranges_of,
    smooth_bank,
    smooth_columns,
)
from lieid_casadi.diagnosis.screening.context import Scene
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]
CARRIED = 0.2  # of what was foretold: other poses may be out of a function's reach
SEEN, TOLD = 1e-4, 0.3  # of a column: less of the model's own, of smooth functions is not fitted


def carried_over(
    left: Sequence[Unexplained], train: Scene, test: Scene, noise: Sequence[Noise]
) -> tuple[Unexplained, ...]:
    """Return the unexplained parts that the test does not contradict.

    Smooth functions are fitted in training; where the test's error does not follow them, they had
    fitted noise. Functions of time do not carry over and are kept.

    Parameters
    ----------
    train, test : Scene
        The same fit along both.
    """
    if not left:
        return ()
    ranges = ranges_of(train.signals)
    banks = [
        smooth_bank(s.signals, s.runs, ranges=ranges).whitened(noise, s.runs) for s in (train, test)
    ]
    residual = train.baseline(noise).residual
    own, other = _columns(train, noise), _columns(test, noise)
    kept = []
    for u in left:
        if "t" in u.depends_on:
            kept.append(u)
            continue
        smooth, on_test = (smooth_columns(bank, u) for bank in banks)
        absorbed = _solved(own, smooth, np.linalg.norm(own, axis=0), SEEN)
        norms = np.linalg.norm(smooth, axis=0)
        values = _solved(smooth - own @ absorbed, residual, norms, TOLD)
        before = _residual(test, noise)
        rows = test.baseline(noise).joint(u.joint)
        foretold = ((on_test - other @ absorbed) @ values)[rows]
        if foretold @ before[rows] >= CARRIED * float(foretold @ foretold):
            kept.append(u)
    return tuple(kept)


def _solved(columns: Array, values: Array, norms: Array, least: float) -> Array:
    """Return least-squares coefficients; directions with less than ``least`` of ``norms`` are out.

    They would be told by noise in training, and blown up on the test.
    """
    scale = np.where(norms > 0.0, norms, 1.0)
    matrix = columns / scale
    inverse = np.linalg.pinv(matrix, rcond=least / max(float(np.linalg.norm(matrix, 2)), 1e-300))
    return np.asarray(((inverse @ values).T / scale).T)


def _columns(scene: Scene, noise: Sequence[Noise]) -> Array:
    rows = zip(noise, scene.columns, scene.runs, strict=True)
    return np.concatenate([n.whiten(matrix, runs) for n, matrix, runs in rows])


def _residual(scene: Scene, noise: Sequence[Noise]) -> Array:
    rows = zip(noise, scene.residual, scene.runs, strict=True)
    return np.concatenate([n.whiten(residual, runs) for n, residual, runs in rows])
