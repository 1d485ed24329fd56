"""Gates that an effect must pass: an ordered list of functions that return a reason, or None."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.diagnosis.candidates import Candidate, shape_limits
from lieid_casadi.recording import Processed

LEAST_SHAPE = 0.5  # of the least value that the motion resolves
AT_BOUND = 0.02  # relative distance from a bound
LEAST_DELAY = 1.0  # samples: a velocity from differences is late by as much, commands are held

#: Of a candidate, its shape parameters and its coefficients: why they are implausible.
Gate = Callable[[Candidate, Array, Array, Sequence[Processed]], str | None]


def implausible_value(
    candidate: Candidate, shapes: Array, values: Array, segments: Sequence[Processed]
) -> str | None:
    """A coefficient outside the bounds that physics sets, or larger than on any real arm."""
    for coefficient, value in zip(candidate.effect.coefficients, values, strict=False):
        text = f"{coefficient.name} = {value:.3g} {coefficient.unit} is"
        if not coefficient.lower <= value <= coefficient.upper:
            return f"{text} physically implausible"
        if abs(value) > coefficient.limit:
            return f"{text} larger than on a real arm (limit {coefficient.limit:g})"
    return None


def unresolved_shape(
    candidate: Candidate, shapes: Array, values: Array, segments: Sequence[Processed]
) -> str | None:
    """A shape parameter that the motion does not resolve, such as a velocity in the dead zone."""
    for shape, value in zip(candidate.effect.shapes, shapes, strict=False):
        least, _ = shape_limits(shape, segments, candidate.joint)
        if shape.data is not None:
            continue
        if value >= shape.upper * (1.0 - AT_BOUND):
            return f"{shape.name} = {value:.2g} {shape.unit} is at the upper end of its range"
        if value < LEAST_SHAPE * least or value <= shape.lower * (1.0 + AT_BOUND):
            return f"{shape.name} = {value:.2g} {shape.unit} is below what this motion can resolve"
    return None


def below_one_sample(
    candidate: Candidate, shapes: Array, values: Array, segments: Sequence[Processed]
) -> str | None:
    """A delay of less than a sample where the signals themselves are uncertain by as much."""
    rate = min(segment.recording.rate for segment in segments)
    for coefficient, value in zip(candidate.effect.coefficients, values, strict=False):
        lead = coefficient.resolved_by == "lead" and value < 0.0
        sampled = lead or coefficient.resolved_by == "sample_time"
        if sampled and abs(value) * rate < LEAST_DELAY:
            return f"{coefficient.name} = {value:.2g} {coefficient.unit} is less than one sample"
    return None


#: In this order; the first reason counts.
GATES: tuple[Gate, ...] = (implausible_value, unresolved_shape, below_one_sample)


def reason_against(
    candidate: Candidate, shapes: Array, values: Array, segments: Sequence[Processed]
) -> str | None:
    """Return the first reason of `GATES` against the fitted values of a candidate, or None.

    A change in the course of a recording may have either sign.
    """
    if candidate.course is not None:
        return None
    found = np.atleast_1d(values)
    reasons = (gate(candidate, shapes, found, segments) for gate in GATES)
    return next((reason for reason in reasons if reason is not None), None)
