"""Unexplained parts with the shape of their smooth functions and a formula."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lieid_casadi.diagnosis.residual.projected_residual import ProjectedResidual
from lieid_casadi.diagnosis.residual.shapes import smooth_shapes
from lieid_casadi.diagnosis.residual.symbolic_formula import find_formula
from lieid_casadi.diagnosis.residual.test_validation import TrainAndTest, confirms_formula
from lieid_casadi.diagnosis.residual.unexplained import Unexplained


def describe_parts(
    parts: Sequence[Unexplained],
    residual: ProjectedResidual,
    recordings: TrainAndTest | None = None,
) -> tuple[Unexplained, ...]:
    """Return unexplained parts with their shapes, and with a formula where one is found.

    Parameters
    ----------
    parts : sequence of Unexplained
    residual : ProjectedResidual
        Of the last model on the training recordings.
    recordings : TrainAndTest, optional
        With these, a formula that the test contradicts is left out.
    """
    described = []
    for part in parts:
        formula = find_formula(part, residual)
        if formula is not None and recordings is not None:
            formula = formula if confirms_formula(formula, part, recordings) else None
        described.append(replace(part, shapes=smooth_shapes(part, residual), formula=formula))
    return tuple(described)
