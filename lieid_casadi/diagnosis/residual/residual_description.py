"""Unexplained parts with the shape of their smooth functions and a formula."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lieid_casadi.diagnosis.residual.projected_residual import ProjectedResidual
from lieid_casadi.diagnosis.residual.shapes import smooth_function, smooth_shapes
from lieid_casadi.diagnosis.residual.symbolic_formula import find_formula
from lieid_casadi.diagnosis.residual.unexplained import Unexplained


def describe_parts(
    parts: Sequence[Unexplained], residual: ProjectedResidual
) -> tuple[Unexplained, ...]:
    """Return unexplained parts with their shapes, and with a formula where one is found.

    Parameters
    ----------
    parts : sequence of Unexplained
    residual : ProjectedResidual
        Of the last model on the training recordings.
    """
    described = []
    for part in parts:
        shapes, formula = smooth_shapes(part, residual), find_formula(part, residual)
        works = formula is not None or _carries_over(part, residual)
        described.append(replace(part, shapes=shapes, formula=formula, carries_over=works))
    return tuple(described)


def _carries_over(part: Unexplained, residual: ProjectedResidual) -> bool:
    """Whether the first smooth function of a part holds for data to which it is not fitted."""
    if not part.terms or "t" in part.terms[0]:
        return False
    return residual.carries_over(smooth_function(part.joint, part.terms[0], residual))
