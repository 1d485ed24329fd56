"""Covariance of all fitted numbers of a model: base values and shape parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.fixed_point import FitState
from lieid_casadi.identification.regression.least_squares import combine, joint_factors, solve
from lieid_casadi.identification.regression.rows import JointRows, Rows
from lieid_casadi.identification.regression.shape_fit import shape_columns
from lieid_casadi.identification.uncertainty.covariance import hac_covariance

Array = NDArray[np.float64]


def fit_covariance(design: Design, state: FitState) -> Array:
    """Return the covariance of values and shapes (p + s, p + s)."""
    rows, values = state.rows, state.solution.values
    residuals = rows.residuals(values)
    unit = state.solution.unit_covariance
    if len(state.shapes):
        slopes = shape_columns(design, values, state.shapes, state.parameters)
        rows = _with_columns(rows, slopes)
        weighted = combine(joint_factors(rows, state.weighting.rows), np.ones(design.model.n))
        unit = solve(weighted).unit_covariance
    return hac_covariance(rows, state.weighting.rows, residuals, unit)


def _with_columns(rows: Rows, further: Sequence[Array]) -> Rows:
    """Return rows with further columns after the p base columns."""
    count = rows.count + further[0].shape[1]
    joints = tuple(
        JointRows(
            np.concatenate([joint.columns, np.arange(rows.count, count)]),
            np.column_stack([joint.matrix, extra]),
            joint.torque,
            joint.instant,
        )
        for joint, extra in zip(rows.joints, further, strict=True)
    )
    return Rows(joints, count, rows.segments)
