"""Whether estimated parameters are physically plausible and resolved by the motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.screening.candidates import Candidate, shape_limits
from lieid_casadi.effects import Effect, Placement, Shape
from lieid_casadi.identification import Fit
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]


def implausible_sign(fit: Fit, placement: Placement) -> str:
    """Return which coefficient of an effect is physically implausible, or an empty text."""
    columns = fit.model.columns
    for column, value in zip(columns, fit.effect_coefficients, strict=True):
        if belongs_to(placement, column.name, column.joint) and value < column.lower:
            return f"{column.label} = {value:.2g} {column.unit} is physically implausible"
    return ""


def implausible_size(effect: Effect, parameters: Mapping[str, float]) -> str:
    """Return which coefficient is larger than on any real arm, or an empty text."""
    for coefficient in effect.coefficients:
        value = parameters.get(coefficient.name, 0.0)
        if abs(value) > coefficient.limit:
            unit = "" if coefficient.unit == "1" else f" {coefficient.unit}"
            return (
                f"{effect.name}.{coefficient.name} = {value:.3g}{unit} is physically implausible "
                f"(limit {coefficient.limit:g}{unit})"
            )
    return ""


def unresolved_shape(
    fit: Fit, placement: Placement, segments: Sequence[Processed], options: DiagnosisOptions
) -> str:
    """Return which shape parameter is below what the motion resolves, or an empty text.

    A velocity scale below the dead zone, for example, is fitted to samples with an uncertain sign.

    Parameters
    ----------
    fit : Fit
    placement : Placement
    segments : sequence of Processed
    options : DiagnosisOptions
    """
    shapes = {shape.name: shape for shape in placement.effect.shapes}
    for parameter, value in zip(fit.model.shapes, fit.shapes, strict=True):
        if belongs_to(placement, parameter.name, parameter.joint):
            shape = shapes[parameter.name.rpartition(".")[2]]
            if is_unresolved(shape, value, segments, placement.joint, options):
                return unresolved_text(parameter.label, value, parameter.unit)
    return ""


def unresolved_point(
    candidate: Candidate, point: Array, segments: Sequence[Processed], options: DiagnosisOptions
) -> str:
    """Return which shape parameter of a grid point is not resolved, or an empty text.

    Parameters
    ----------
    candidate : Candidate
    point : (s,)
        Of its grid.
    segments : sequence of Processed
    options : DiagnosisOptions
    """
    for shape, value in zip(candidate.effect.shapes, point, strict=False):
        if is_unresolved(shape, value, segments, candidate.joint, options):
            label = f"{candidate.name}.{shape.name}:{candidate.joint + 1}"
            return unresolved_text(label, float(value), shape.unit)
    return ""


def unresolved_text(label: str, value: float, unit: str) -> str:
    """Return the reason for which a shape parameter is rejected.

    Parameters
    ----------
    label : str
        Of the shape parameter.
    value : float
    unit : str
    """
    return f"{label} = {value:.2g} {unit} is below the range that this motion can resolve"


def is_unresolved(
    shape: Shape,
    value: float,
    segments: Sequence[Processed],
    joint: int,
    options: DiagnosisOptions,
) -> bool:
    """Whether a shape parameter is at its lower bound or below what a joint's motion resolves.

    Parameters
    ----------
    shape : Shape
    value : float
        In the unit of the shape parameter.
    segments : sequence of Processed
    joint : int
        From 0.
    options : DiagnosisOptions
    """
    least, _ = shape_limits(shape, segments, joint, options)
    bound = shape.lower * (1.0 + options.shape_at_bound)
    return value < options.least_shape * least or value <= bound


def belongs_to(placement: Placement, name: str, joint: int | None) -> bool:
    """Whether a parameter ``effect.name`` on a joint belongs to a placed effect.

    Parameters
    ----------
    placement : Placement
    name : str
        ``effect.name`` of a parameter.
    joint : int or None
        From 0.
    """
    return joint == placement.joint and name.rpartition(".")[0] == placement.effect.label


def below_sample_time(
    effect: Effect,
    parameters: Mapping[str, float],
    segments: Sequence[Processed],
    options: DiagnosisOptions,
) -> str:
    """Return which coefficient is too small for the sampling rate, or an empty text.

    A torque that lags is resolved below one sample: a velocity is never early, so that no error of
    differentiation imitates it.

    Parameters
    ----------
    effect : Effect
    parameters : mapping
        Coefficients by name.
    segments : sequence of Processed
    options : DiagnosisOptions
    """
    rate = min(segment.recording.rate for segment in segments)
    for coefficient in effect.coefficients:
        value = parameters.get(coefficient.name, 0.0)
        lead = coefficient.resolved_by == "lead" and value < 0.0
        if not lead and coefficient.resolved_by != "sample_time":
            continue
        if abs(value) * rate < options.least_delay_samples:
            cause = (
                "a velocity computed by differences is late by as much"
                if lead
                else "commands are held for as long"
            )
            return (
                f"{coefficient.name} = {value:.2g} {coefficient.unit} is less than one sample; "
                f"{cause}"
            )
    return ""
