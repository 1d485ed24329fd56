"""Whether the test recordings confirm what was found unexplained in training; reported only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.projected_residual import ProjectedResidual
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.smooth_functions import (
    signal_ranges,
    smooth_candidates,
    smooth_columns,
)
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]
#: Parts of a unit column below which a direction is not fitted, since noise in training would
#: determine its coefficient: of the model's columns, and of smooth functions.
LEAST_MODEL_PART, LEAST_SMOOTH_PART = 1e-4, 0.3


@dataclass(frozen=True, eq=False)
class TrainAndTest:
    """The same fit along the training and along the test recordings.

    Attributes
    ----------
    train, test : ScreeningContext
    noise : tuple of Noise
        White noise of each joint.
    """

    train: ScreeningContext
    test: ScreeningContext
    noise: tuple[Noise, ...]

    def whitened(self, context: ScreeningContext, values: Sequence[Array]) -> Array:
        """Return values (N_j, …) of all joints, whitened and stacked (R, …)."""
        return np.concatenate(context.whitened(self.noise, values))


def with_test_results(
    parts: Sequence[Unexplained], recordings: TrainAndTest
) -> tuple[Unexplained, ...]:
    """Return the unexplained parts with what the test showed (`Unexplained.confirmed`).

    The formula, or smooth functions where there is none, are fitted in training; confirmed means
    that they reduce the test error of their joint. Functions of time differ between recordings,
    so that a test cannot confirm them.
    """
    return tuple(
        part if "t" in part.depends_on else replace(part, confirmed=_error_falls(part, recordings))
        for part in parts
    )


def _error_falls(part: Unexplained, recordings: TrainAndTest) -> bool:
    """Whether the error of a part's joint on the test falls with what was found in training."""
    train, test, noise = recordings.train, recordings.test, recordings.noise
    own, other = (recordings.whitened(c, c.model_columns) for c in (train, test))
    columns, on_test = _columns(part, recordings)
    absorbed = _solved(own, columns, np.linalg.norm(own, axis=0), LEAST_MODEL_PART)
    if part.formula is not None:
        values = np.array(part.formula.values)
    else:
        rest = columns - own @ absorbed
        norms = np.linalg.norm(columns, axis=0)
        values = _solved(rest, train.baseline(noise).residual, norms, LEAST_SMOOTH_PART)
    rows = test.baseline(noise).joint(part.joint)
    before = recordings.whitened(test, test.residual)[rows]
    after = before - ((on_test - other @ absorbed) @ values)[rows]
    return bool(after @ after < before @ before)


def _columns(part: Unexplained, recordings: TrainAndTest) -> tuple[Array, Array]:
    """Return the columns (R, k) of a part's formula or smooth functions in training and test."""
    contexts, noise = (recordings.train, recordings.test), recordings.noise
    if part.formula is None:
        ranges = signal_ranges(recordings.train.signals)
        smooth = (smooth_candidates(c.signals, c.runs, ranges=ranges) for c in contexts)
        first, second = (
            smooth_columns(f.whitened(noise, c.runs), part.joint, part.depends_on)
            for f, c in zip(smooth, contexts, strict=True)
        )
    else:
        terms = part.formula.terms
        residuals = [ProjectedResidual.of(c, noise, c.baseline(noise)) for c in contexts]
        first, second = (
            r.columns(part.joint, [np.column_stack([t.along(s) for t in terms]) for s in r.signals])
            for r in residuals
        )
    return first, second


def _solved(columns: Array, values: Array, norms: Array, least: float) -> Array:
    """Return least-squares coefficients (k, …) of columns (R, k) for values (R, …).

    Directions with less than ``least`` of the norms (k,) have the coefficient zero.
    """
    scale = np.where(norms > 0.0, norms, 1.0)
    matrix = columns / scale
    inverse = np.linalg.pinv(matrix, rcond=least / max(float(np.linalg.norm(matrix, 2)), 1e-300))
    return np.asarray(((inverse @ values).T / scale).T)
