"""Whether numbers that a refit found can be what the effect says they are."""

from __future__ import annotations

from collections.abc import Sequence

from lieid_casadi.diagnosis.screening.candidates import shape_limits
from lieid_casadi.effects import Placement, Shape
from lieid_casadi.identification import Fit
from lieid_casadi.recording import Processed

SPARE = 0.5  # of the least shape that a motion shows
AT_BOUND = 0.02  # over the bound


def out_of_bounds(fit: Fit, placement: Placement) -> str:
    """Return which coefficient of an effect has a sign that the physics rules out, or nothing."""
    columns = fit.model.columns
    for column, value in zip(columns, fit.effect_coefficients, strict=True):
        if _of(placement, column.name, column.joint) and value < column.lower:
            return f"{column.label} = {value:.2g} {column.unit} cannot be"
    return ""


def beyond_motion(fit: Fit, placement: Placement, segments: Sequence[Processed]) -> str:
    """Return which shape parameter left what the motion can show, or nothing.

    A width in velocity below the dead zone is made of samples whose sign is anyone's guess.
    """
    shapes = {shape.name: shape for shape in placement.effect.shapes}
    for parameter, value in zip(fit.model.shapes, fit.shapes, strict=True):
        if _of(placement, parameter.name, parameter.joint):
            name = parameter.name.rpartition(".")[2]
            if hardly_there(shapes[name], value, segments, placement.joint):
                return f"{parameter.label} = {value:.2g} {parameter.unit} is less than motion shows"
    return ""


def hardly_there(shape: Shape, value: float, segments: Sequence[Processed], joint: int) -> bool:
    """Whether a shape parameter is at its lower bound, or below what a joint's motion shows."""
    least, _ = shape_limits(shape, segments, joint)
    return value < SPARE * least or value <= shape.lower * (1.0 + AT_BOUND)


def _of(placement: Placement, name: str, joint: int | None) -> bool:
    return joint == placement.joint and name.rpartition(".")[0] == placement.effect.label
