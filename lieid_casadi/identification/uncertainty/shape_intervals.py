"""Intervals of shape parameters from the profile of the weighted error.

The error depends on a shape parameter nonlinearly: its profile may be wide on one side, have
several minima, or never rise towards an end of the range. The interval is all values between the
outermost at which the profile is below the χ² limit. Noise that is correlated in time makes it
deeper than independent rows would; the limit is raised by the ratio of the variance of the
effect's parameters from `covariance` to that of independent rows (the scaling of a composite
likelihood: Varin, Reid, Firth, Statistica Sinica 2011), and for other minima, whose columns may be
slower, by the largest ratio. Others are eliminated to first order, linear parameters exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from lieid_casadi.arrays import Array
from lieid_casadi.errors import BoundWarning, LieidWarning
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.fixed_point import FitState
from lieid_casadi.identification.regression.least_squares import Rows, combine, solve
from lieid_casadi.identification.regression.resolved_shapes import resolved_range
from lieid_casadi.identification.regression.shape_scan import ShapeScan, WeightedProjection
from lieid_casadi.identification.regression.variable_projection import shape_columns
from lieid_casadi.identification.uncertainty.covariance import (
    residual_correlation_length,
    with_columns,
)
from lieid_casadi.messages import in_unit

LEVEL = 0.95
NEAR = np.array([-4, -3, -2.5, -2, -1.5, -1, -0.5, 0, 0.5, 1, 1.5, 2, 2.5, 3, 4])  # of its std
WIDEST = 0.05  # of the range, of one step of these


@dataclass(frozen=True, eq=False)
class ShapeIntervals:
    """Bounds (s,) of the shapes with a probability of 95 %; NaN for those that are not fitted.

    ``open_below`` and ``open_above`` (s,) mark where the interval ends at the end of the range.
    """

    low: Array
    high: Array
    open_below: Array
    open_above: Array


def shape_intervals(design: Design, state: FitState, covariance: Array) -> ShapeIntervals:
    """Return the intervals of the shapes of a fit with a covariance (p + s, p + s)."""
    count = len(state.shapes)
    ends, opens = np.full((2, count), np.nan), np.zeros((2, count), dtype=bool)
    scan, weights = state.scan, 1.0 / state.weighting.noise
    if scan is None:  # shapes were held
        return ShapeIntervals(*ends, *opens)
    slopes = shape_columns(design, state.solution.values, state.shapes, state.parameters)
    whole = with_columns(state.rows, slopes)
    independent = solve(combine(whole.factors, weights)).unit_covariance
    slowest, first, model = _slowest_growth(state), state.rows.count, design.model
    ranges = resolved_range(design)
    for number, member in enumerate(scan.members):
        for own, k in enumerate(member.effect.shapes):
            variance = float(covariance[first + k, first + k])
            numbers = [first + k, *member.effect.columns]
            alone = np.diag(independent)[numbers]
            ratios = np.diag(covariance)[numbers] / np.where(alone > 0.0, alone, np.inf)
            growth = max(float(ratios.max()), 1.0)
            profile = _Profile(scan, state, whole, number, own)
            step = min(np.sqrt(variance) / float(ranges.slope(state.shapes)[k]), WIDEST)
            place = float(ranges.place(state.shapes)[k])
            limit = growth * float(chi2.ppf(LEVEL, 1))
            near = np.clip(place + NEAR * step, 0.0, 1.0)
            tried = np.tile(state.shapes, (len(near), 1))
            tried[:, k] = [ranges.shapes(np.full(count, p))[k] for p in near]
            values, excess = profile.excess(tried[:, k])
            at = np.tile(state.shapes, (len(values), 1))
            at[:, k] = values
            places = ranges.place(at)[:, k]
            far = slowest[model.shapes[k].joint] * float(chi2.ppf(LEVEL, 1))
            low, high = _hull(places, excess, place, limit, max(limit, far))
            opens[:, k] = low <= 0.0, high >= 1.0
            ends[:, k] = [ranges.shapes(np.full(count, p))[k] for p in (low, high)]
    return ShapeIntervals(ends[0], ends[1], opens[0], opens[1])


class _Profile:
    """The weighted error over one shape of a member of the scan, above that of the fit."""

    def __init__(self, scan: ShapeScan, state: FitState, rows: Rows, number: int, own: int) -> None:
        self._scan, self._state, self._number, self._own = scan, state, number, own
        self._member = scan.members[number]
        effect = self._member.effect
        varying = np.append(effect.columns, state.rows.count + effect.shapes[own])
        self._projection = WeightedProjection(rows, varying, state.weighting.noise)
        self._least = self._projection.falls(
            self._projection.present(self._member, state.rows), []
        )[0]

    def excess(self, near: Array) -> tuple[Array, Array]:
        """Return values (G,) over the range and near the fit, ascending, and the excess there."""
        state, member = self._state, self._member
        if len(member.effect.shapes) == 1:
            grid = member.grid[:, 0]
            columns = self._scan.grid_columns(self._number, state.shapes, state.parameters)
            over = self._projection.falls(self._projection.trial(columns), [])
        else:
            grid = np.unique(member.grid[:, self._own])
            over = self._falls(grid)
        values, falls = np.concatenate([near, grid]), np.concatenate([self._falls(near), over])
        order = np.argsort(values, kind="stable")
        return values[order], (self._least - falls)[order]

    def _falls(self, values: Array) -> Array:
        """Return the fall of the cost at values (G,) of the shape, others as fitted."""
        state, member = self._state, self._member
        tried = np.tile(state.shapes[member.effect.shapes], (len(values), 1))
        tried[:, self._own] = values
        columns = self._scan.columns(self._number, tried, state.shapes, state.parameters)
        return self._projection.falls(self._projection.trial(columns), [])


def _hull(
    places: Array, excess: Array, fitted: float, limit: float, far: float
) -> tuple[float, float]:
    """Return the outermost places at which the profile is below its limit.

    Beside the minimum of the fit that is ``limit``; beyond a ridge above it, ``far``.
    """
    at = int(np.argmin(np.abs(places - fitted)))
    inside = excess <= limit
    inside[at] = True
    left = at - int(np.argmin(np.append(inside[at::-1], False))) + 1
    right = at + int(np.argmin(np.append(inside[at:], False))) - 1
    limits = np.where(
        (np.arange(len(places)) >= left) & (np.arange(len(places)) <= right), limit, far
    )
    padded = np.concatenate([[np.inf], excess, [np.inf]])
    minima = np.flatnonzero((excess <= padded[:-2]) & (excess <= padded[2:]) & (excess <= far))
    first, last = int(min([left, *minima])), int(max([right, *minima]))

    def crossing(within: int, beyond: int) -> float:
        if not 0 <= beyond < len(places):
            return float(places[within])
        rise = excess[beyond] - excess[within]
        part = (limits[within] - excess[within]) / rise if rise > 0.0 else 1.0
        return float(places[within] + np.clip(part, 0.0, 1.0) * (places[beyond] - places[within]))

    low, high = crossing(first, first - 1), crossing(last, last + 1)
    return min(low, fitted), max(high, fitted)


def _slowest_growth(state: FitState) -> Array:
    """Return the growth (n,) of the variance of a mean by the residual's correlation in time.

    No column has a larger one: correlated noise is largest at low frequencies.
    """
    line = np.nan_to_num(state.rows.on_time_line(state.solution.values))
    lags = residual_correlation_length(state.rows, state.rows.residuals(state.solution.values))
    growth = np.ones(line.shape[1])
    for j, residual in enumerate(line.T):
        square = float(residual @ residual)
        if square > 0.0:
            products = [float(residual[k:] @ residual[:-k]) for k in range(1, lags + 1)]
            growth[j] = max(1.0 + 2.0 * sum(products) / square, 1.0)
    return growth


def open_intervals(design: Design, state: FitState, found: ShapeIntervals) -> list[LieidWarning]:
    """Return warnings about shapes that the recordings do not bound on one side, or on both."""
    warnings: list[LieidWarning] = []
    at_bound = resolved_range(design).at_bound(state.shapes)
    for k, shape in enumerate(design.model.shapes):
        if not shape.fitted or at_bound[k] or not (found.open_below[k] or found.open_above[k]):
            continue
        sides = [
            name
            for name, is_open in (("below", found.open_below[k]), ("above", found.open_above[k]))
            if is_open
        ]
        size = in_unit(f"{state.shapes[k]:.3g}", shape.unit)
        warnings.append(
            BoundWarning(
                f"{shape.label} = {size}: the recordings do not bound "
                f"it from {' or '.join(sides)} (95 % interval {found.low[k]:.3g} to "
                f"{found.high[k]:.3g}); record more of the motion that reveals the effect"
            )
        )
    return warnings
