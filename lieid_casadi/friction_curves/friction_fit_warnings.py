"""Warnings about a friction model fitted to a friction curve."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import (
    BoundWarning,
    ExtrapolationWarning,
    LieidWarning,
    NotDissipativeWarning,
    UnidentifiableWarning,
)
from lieid_casadi.friction_curves.friction_fit import FrictionFit
from lieid_casadi.identification.regression.variable_projection import ShapeRange

PART = 0.05  # of a direction's largest component, above which a parameter is named
FAR = 0.5  # of the largest measured friction, by which an extrapolation may leave its range
SLOWEST = 0.05  # of the slowest measured speed, down to which the extrapolation is checked
POINTS = 80  # speeds


def friction_fit_warnings(fit: FrictionFit, hidden: Sequence[Array]) -> tuple[LieidWarning, ...]:
    """Return warnings of parameters at bounds or not identifiable, and of implausible friction.

    ``hidden``: directions of coefficients and shapes that the curve does not determine.
    """
    return (*_bounds(fit), *_not_identifiable(fit, hidden), *_uncertain(fit), *_implausible(fit))


def _bounds(fit: FrictionFit) -> list[LieidWarning]:
    found: list[LieidWarning] = []
    at_bound = ShapeRange.of(fit.model.shapes).at_bound(fit.shapes)
    for shape, value, at_end in zip(fit.model.shapes, fit.shapes, at_bound, strict=True):
        if at_end:
            found.append(
                BoundWarning(
                    f"{shape.label} is at its bound {value:.3g} {shape.unit} (range "
                    f"{shape.lower:g} to {shape.upper:g}); the curve shows little of this effect"
                )
            )
    for column, value in zip(fit.model.columns, fit.coefficients, strict=True):
        if np.isclose(value, column.lower) or np.isclose(value, column.upper):
            found.append(BoundWarning(f"{column.label} is at its bound {value:.3g} {column.unit}"))
    return found


def _not_identifiable(fit: FrictionFit, hidden: Sequence[Array]) -> list[LieidWarning]:
    """Warn of parameters that half the difference of both directions does not determine."""
    found: list[LieidWarning] = []
    for direction in hidden:
        part = np.abs(direction) / np.abs(direction).max()
        names = [p.label for p, x in zip(fit.parameters, part, strict=True) if x > PART]
        what = (
            f"{names[0]} cannot be identified"
            if len(names) == 1
            else f"{', '.join(names)} cannot be separated"
        )
        found.append(UnidentifiableWarning(f"{what} by this curve"))
    return found


def _uncertain(fit: FrictionFit) -> list[LieidWarning]:
    """Warn of parameters whose standard deviation exceeds their value."""
    values = np.concatenate([fit.coefficients, fit.shapes])
    uncertain = np.isfinite(fit.std) & (fit.std > np.abs(values))
    names = [p.label for p, x in zip(fit.parameters, uncertain, strict=True) if x]
    if not names:
        return []
    return [
        UnidentifiableWarning(
            f"{', '.join(names)}: the standard deviation exceeds the value; use a model with "
            "fewer parameters, or record more speeds and loads"
        )
    ]


def _implausible(fit: FrictionFit) -> list[LieidWarning]:
    """Warn of negative friction, and of extreme values below the slowest measured speed."""
    curve, unit = fit.curve, fit.curve.unit
    slowest, fastest = float(curve.speed.min()), float(curve.speed.max())
    speeds = np.geomspace(SLOWEST * slowest, fastest, POINTS)
    loads = np.array([curve.load.min(), curve.load.max()])
    friction = fit.friction(np.tile(speeds, 2), load=np.repeat(loads, len(speeds)))
    below = np.tile(speeds, 2) < slowest
    most = float(np.abs(curve.friction).max())
    found: list[LieidWarning] = []
    if np.any(friction[~below] < 0.0):
        found.append(
            NotDissipativeWarning(
                f"joint {curve.joint + 1}: the fitted friction is negative, that is, it drives the "
                f"joint, at some speed from {slowest:.3g} to {fastest:.3g} rad/s"
            )
        )
    worst = friction[below][np.argmax(np.abs(friction[below] - 0.5 * most))]
    if not -FAR * most < worst < (1.0 + FAR) * most:
        found.append(
            ExtrapolationWarning(
                f"joint {curve.joint + 1}: below the slowest measured speed of {slowest:.3g} rad/s "
                f"the fitted friction reaches {worst:.3g} {unit} (measured: at most {most:.3g}); "
                "record slower motion or use a model with fewer parameters"
            )
        )
    return found
