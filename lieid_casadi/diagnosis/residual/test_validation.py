"""Comparison of what was found unexplained in training with the test recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.projected_residual import ProjectedResidual
from lieid_casadi.diagnosis.residual.symbolic_formula import Formula
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


def confirmed_parts(
    parts: Sequence[Unexplained], recordings: TrainAndTest
) -> tuple[Unexplained, ...]:
    """Return the unexplained parts that the test does not contradict.

    Smooth functions are fitted in training; where the error on the test does not follow them,
    they had fitted noise. Functions of time differ between recordings and are kept.
    """
    if not parts:
        return ()
    train, test, noise = recordings.train, recordings.test, recordings.noise
    ranges = signal_ranges(train.signals)
    functions = [
        smooth_candidates(c.signals, c.runs, ranges=ranges).whitened(noise, c.runs)
        for c in (train, test)
    ]
    residual = train.baseline(noise).residual
    own = recordings.whitened(train, train.model_columns)
    other = recordings.whitened(test, test.model_columns)
    before = recordings.whitened(test, test.residual)
    kept = []
    for part in parts:
        if "t" in part.depends_on:
            kept.append(part)
            continue
        smooth, on_test = (smooth_columns(f, part.joint, part.depends_on) for f in functions)
        absorbed = _solved(own, smooth, np.linalg.norm(own, axis=0), LEAST_MODEL_PART)
        norms = np.linalg.norm(smooth, axis=0)
        values = _solved(smooth - own @ absorbed, residual, norms, LEAST_SMOOTH_PART)
        rows = test.baseline(noise).joint(part.joint)
        predicted = ((on_test - other @ absorbed) @ values)[rows]
        least = train.options.least_validated_part * float(predicted @ predicted)
        if predicted @ before[rows] >= least:
            kept.append(part)
    return tuple(kept)


def confirms_formula(formula: Formula, part: Unexplained, recordings: TrainAndTest) -> bool:
    """Whether a formula with its training coefficients reduces the error on the test.

    Parameters
    ----------
    formula : Formula
    part : Unexplained
        Its joint, and the part of the variance that the formula should explain.
    recordings : TrainAndTest
    """
    train, test, noise = recordings.train, recordings.test, recordings.noise
    residuals = [ProjectedResidual.of(c, noise, c.baseline(noise)) for c in (train, test)]
    columns = [
        r.columns(part.joint, [np.column_stack([t.along(s) for t in formula.terms])
                               for s in r.signals])
        for r in residuals
    ]  # fmt: skip
    own = [recordings.whitened(c, c.model_columns) for c in (train, test)]
    size = np.linalg.norm(own[0], axis=0)
    size[size == 0.0] = 1.0
    absorbed = np.linalg.lstsq(own[0] / size, columns[0], rcond=LEAST_MODEL_PART)[0]
    absorbed = absorbed / size[:, None]
    rows = residuals[1].baseline.joint(part.joint)
    before = recordings.whitened(test, test.residual)[rows]
    after = before - ((columns[1] - own[1] @ absorbed) @ np.array(formula.values))[rows]
    fall = float(np.sum(before**2) - np.sum(after**2))
    expected = part.fraction * float(np.sum(before**2))
    return fall >= train.options.least_validated_formula_part * expected


def _solved(columns: Array, values: Array, norms: Array, least: float) -> Array:
    """Return least-squares coefficients (k, …) of columns (R, k) for values (R, …).

    Directions with less than ``least`` of the norms (k,) have the coefficient zero.
    """
    scale = np.where(norms > 0.0, norms, 1.0)
    matrix = columns / scale
    inverse = np.linalg.pinv(matrix, rcond=least / max(float(np.linalg.norm(matrix, 2)), 1e-300))
    return np.asarray(((inverse @ values).T / scale).T)
