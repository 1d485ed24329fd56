"""Which values of shape parameters recordings resolve: one definition for fits and candidates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.effects import Shape
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.variable_projection import ShapeRange
from lieid_casadi.recording import Processed

#: Time constants, relative to the longest segment: a shorter one is over before the first
#: reversal, a longer one is a straight line in time.
TIME_CONSTANTS = (0.05, 2.0)
#: Least velocity scale in dead zones, in which the sign of the velocity is uncertain, and largest
#: one relative to the top speed, beyond which a column is close to a polynomial.
VELOCITY_SCALES = (3.0, 0.35)
#: Least width of a hysteresis, in the distance that a joint passes in a sample at the speed of the
#: dead zone: friction that builds up sooner changes its sign at another instant, and no more.
LEAST_WIDTH = 6.0
LEAST_COUNTS = 4.0  # steps of the recorded position: a narrower deflection lies between two
LEAST_SHAPE = 0.5  # of the least value that is tried: a fitted one below is not resolved
#: Percentiles of |error| between which saturation is searched, and the lower one in a fit of drives
#: whose law, and with it the stiffness, is known.
COMMAND_ERRORS = (80.0, 99.5)
KNOWN_STIFFNESS = 25.0


def shape_limits(shape: Shape, segments: Sequence[Processed], joint: int) -> tuple[float, float]:
    """Return the bounds of a shape parameter that a joint's motion resolves, in its unit."""
    if shape.resolved_by == "duration":
        longest = max(float(segment.t[-1] - segment.t[0]) for segment in segments)
        low, high = (part * longest for part in TIME_CONSTANTS)
    elif shape.resolved_by == "speed":
        top = max(float(np.percentile(np.abs(s.dq[:, joint]), 99.0)) for s in segments)
        low = VELOCITY_SCALES[0] * max(float(s.dead_zone[joint]) for s in segments)
        high = VELOCITY_SCALES[1] * top
    elif shape.resolved_by == "distance":
        low = LEAST_WIDTH * max(float(s.dead_zone[joint]) / s.rate for s in segments)
        low = max(low, LEAST_COUNTS * max(float(s.position_step[joint]) for s in segments))
        high = shape.upper
    elif shape.resolved_by == "command_error":
        low, high = command_error_range(segments, joint)
    else:
        return shape.lower, shape.upper
    low = min(max(low, shape.lower), 0.5 * shape.upper)
    return low, min(max(high, 2.0 * low), shape.upper)


def command_error_range(segments: Sequence[Processed], joint: int) -> tuple[float, float]:
    """Return the errors of position control between which a joint in motion shows saturation, rad.

    Those of the largest fifth for a stiffness that is not known: where torque saturates at smaller
    errors than most of the recorded ones, the column of the effect is the recorded torque itself,
    but for a constant, and every model fits.
    """
    drives = segments[0].recording.drives
    least = COMMAND_ERRORS[0] if drives is None else KNOWN_STIFFNESS
    sizes = []
    for s in segments:
        if s.command_error is not None:
            moving = np.abs(s.dq[:, joint]) > s.dead_zone[joint]
            sizes.append(np.abs(s.command_error[moving, joint]))
    every = np.concatenate(sizes) if sizes else np.zeros(0)
    low, high = np.percentile(every, (least, COMMAND_ERRORS[1])) if len(every) else (0.0, 0.0)
    return float(low), float(high)


def least_resolved(shape: Shape, segments: Sequence[Processed], joint: int) -> float:
    """Return the least value of a shape parameter that counts as resolved, in its unit."""
    least, _ = shape_limits(shape, segments, joint)
    return max(LEAST_SHAPE * least, shape.lower) if shape.resolved_by else shape.lower


def resolved_range(design: Design) -> ShapeRange:
    """Return the bounds within which the shapes of a model are fitted.

    Friction over a smaller scale of velocity acts where the sign of the velocity is uncertain
    alone: it would explain errors of dry friction there, in place of what it is for.
    """
    whole = ShapeRange.of(design.model.shapes)
    lower, upper = whole.lower.copy(), whole.upper.copy()
    shapes = [(p.joint, shape) for p in design.model.placements for shape in p.effect.shapes]
    for k, (joint, shape) in enumerate(shapes):
        if shape.resolved_by == "command_error":
            low, high = np.clip(command_error_range(design.segments, joint), lower[k], upper[k])
            if low < high:
                lower[k], upper[k] = low, high
        elif shape.resolved_by == "speed":
            lower[k] = least_resolved(shape, design.segments, joint)
    return ShapeRange(lower, upper)
