"""Fit of a friction model to a friction curve, with bounds and several starting points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear

from lieid_casadi.compiled import compile
from lieid_casadi.effects import Effect, Placement
from lieid_casadi.effects.friction_models import FRICTION_MODELS
from lieid_casadi.effects.placement import place
from lieid_casadi.errors import EffectError
from lieid_casadi.friction_curves.curve import FrictionCurve
from lieid_casadi.friction_curves.friction_fit import FrictionFit
from lieid_casadi.friction_curves.friction_fit_warnings import friction_fit_warnings
from lieid_casadi.identification.regression.shape_range import ShapeRange
from lieid_casadi.model import Model

Array = NDArray[np.float64]
SAMPLED_STARTS = 40  # random starting points, the best of which are used
DESCENTS = 4  # local searches
FINALISTS = 2  # of them that are continued on all instants
CONVERGED = 1e-4  # relative change of the cost on all instants, far below the effect of noise
STEP = 1e-5  # finite difference relative to the range of a shape
ZERO_COLUMN = 1e-9  # norm relative to the largest column below which a column counts as zero
RANK = 1e-7  # relative singular value below which a direction is not determined by the curve


def fit_friction(
    curve: FrictionCurve,
    effects: str | Iterable[str | Effect],
    *,
    starts: int = DESCENTS,
    seed: int = 0,
) -> FrictionFit:
    """Fit a friction model to a friction curve, weighted by the standard errors of its points.

    Shape parameters are searched within their bounds by trust-region least squares from the best
    of many random starting points; the linear coefficients follow for each of them by bounded
    linear least squares (variable projection). The columns of the effects are matched and
    averaged in the same way as the torque.

    Parameters
    ----------
    curve : FrictionCurve
    effects : str or sequence of str or Effect
        Name of a friction model (`FRICTION_MODELS`), or effects such as
        ``"coulomb,viscous,load_friction"``, without joint or with that of the curve.
    starts : int
        Number of local searches, at least 1.
    seed : int
        Seed of the random starting points.

    Returns
    -------
    FrictionFit

    Raises
    ------
    EffectError
        An effect is unknown, acts on or from another joint, or needs a temperature that the
        recordings do not have.
    ValueError
        ``starts`` is below 1.
    """
    if starts < 1:
        raise ValueError(f"starts is {starts}; expected at least 1")
    problem = _CurveProblem(curve, _placements(curve, effects))
    shapes = problem.search(starts, np.random.default_rng(seed))
    coefficients = problem.coefficients(shapes)
    predicted = problem.columns(shapes) @ coefficients
    covariance, hidden = problem.covariance(shapes, coefficients)
    fit = FrictionFit(
        curve=curve,
        model=problem.model,
        coefficients=coefficients,
        shapes=shapes,
        covariance=covariance,
        predicted=predicted,
        warnings=(),
    )
    return replace(fit, warnings=friction_fit_warnings(fit, hidden))


def _placements(
    curve: FrictionCurve, effects: str | Iterable[str | Effect]
) -> tuple[Placement, ...]:
    if isinstance(effects, str):
        known = FRICTION_MODELS.get(effects.strip())
        named = known.effects if known is not None else effects.split(",")
        effects = [name for name in named if name.strip()]
    n, joint = curve.data.robot.n, curve.joint
    placed: list[Placement] = []
    for spec in effects:
        own_joints = isinstance(spec, str) and ":" in spec
        placed += place(spec, n) if own_joints else place(spec, n, [joint])
    if not placed:
        raise EffectError("no effects given; expected e.g. coulomb,viscous")
    for p in placed:
        if hasattr(p.effect, "along"):
            raise EffectError(
                f"{p.effect.label} is not friction of one joint; use identify instead"
            )
        if p.joint != joint or p.source is not None:
            raise EffectError(f"effect {p.label} does not act on joint {joint + 1} of the curve")
        if "temperature" in p.effect.signals and not curve.data.has_temperature:
            raise EffectError(f"{p.effect.label} needs temperature; expected columns temp1…temp{n}")
    return tuple(placed)


class _CurveProblem:
    """Weighted least squares of a curve's points in coefficients and shapes."""

    def __init__(self, curve: FrictionCurve, placements: Sequence[Placement]) -> None:
        self.curve = curve
        self.model = Model.of_placements(curve.data.robot, placements)
        self.compiled = compile(self.model)
        self.ranges = ShapeRange.of(self.model.shapes)
        self.weight = 1.0 / np.maximum(curve.std, 1e-3 * np.median(curve.std) + 1e-12)
        self.lower = np.array([c.lower for c in self.model.columns])
        self.upper = np.array([c.upper for c in self.model.columns])

    def columns(self, shapes: Array, *, thinned: bool = False) -> Array:
        """Return the columns' averages per point (G, m)."""
        data, joint = self.curve.data, self.curve.joint
        return data.columns(self.compiled, joint, shapes, thinned=thinned)

    def coefficients(self, shapes: Array) -> Array:
        """Return the best coefficients (m,) at given shapes."""
        return self._solve(self.columns(shapes))

    def _solve(self, columns: Array) -> Array:
        matrix = columns * self.weight[:, None]
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale <= ZERO_COLUMN * scale.max(initial=0.0)] = np.inf
        target = self.curve.friction * self.weight
        free = np.linalg.lstsq(matrix / scale, target, rcond=1e-10)[0] / scale
        if np.all((free >= self.lower) & (free <= self.upper)):
            return np.asarray(free)
        finite = np.where(np.isinf(scale), 1.0, scale)
        bounds = (self.lower * finite, self.upper * finite)
        return np.asarray(lsq_linear(matrix / finite, target, bounds).x / finite)

    def residual(self, shapes: Array, *, thinned: bool = False) -> Array:
        """Return the weighted residual (G,) with the best coefficients."""
        columns = self.columns(shapes, thinned=thinned)
        return (self.curve.friction - columns @ self._solve(columns)) * self.weight

    def search(self, descents: int, random: np.random.Generator) -> Array:
        """Return the best shapes (s,): found on some of the instants, then on all."""
        first = self.model.initial_shapes
        if not len(first):
            return first

        def misfit(shapes: Array) -> float:
            return _square(self.residual(shapes, thinned=True))

        drawn = self.ranges.shapes(_spread(SAMPLED_STARTS, len(first), random))
        starts = sorted([first, *drawn], key=misfit)
        found = sorted((self._descend(x, thinned=True) for x in starts[:descents]), key=misfit)
        final = [self._descend(shapes, thinned=False) for shapes in found[:FINALISTS]]
        return min(final, key=lambda shapes: _square(self.residual(shapes)))

    def _descend(self, start: Array, *, thinned: bool) -> Array:
        def residual(place: Array) -> Array:
            return self.residual(self.ranges.shapes(place), thinned=thinned)

        inside = np.clip(self.ranges.place(start), 1e-6, 1.0 - 1e-6)
        steps = np.full(len(start), 1e-6)
        enough = 1e-8 if thinned else CONVERGED
        result = least_squares(
            residual, inside, bounds=(0.0, 1.0), diff_step=steps, max_nfev=50, ftol=enough
        )
        return self.ranges.shapes(np.asarray(result.x))

    def slopes(self, shapes: Array, coefficients: Array) -> Array:
        """Return ∂friction/∂shape (G, s)."""
        here = self.columns(shapes) @ coefficients
        steps = STEP * self.ranges.slope(shapes)
        moved = [
            self.columns(shapes + step * unit) @ coefficients
            for step, unit in zip(steps, np.eye(len(shapes)), strict=True)
        ]
        changes = [(m - here) / step for m, step in zip(moved, steps, strict=True)]
        return np.array(changes).reshape(len(shapes), len(here)).T

    def covariance(self, shapes: Array, coefficients: Array) -> tuple[Array, list[Array]]:
        """Return the covariance (m + s, m + s), infinite where nothing is known, and why."""
        matrix = np.column_stack([self.columns(shapes), self.slopes(shapes, coefficients)])
        matrix = matrix * self.weight[:, None]
        residual = self.residual(shapes)
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale <= ZERO_COLUMN * scale.max(initial=0.0)] = 1.0
        _, sizes, vt = np.linalg.svd(matrix / scale, full_matrices=True)
        sizes = np.pad(sizes, (0, len(vt) - len(sizes)))
        seen = sizes > RANK * sizes[0]
        inverse = vt[seen].T / sizes[seen] / scale[:, None]
        freedom = max(len(residual) - int(seen.sum()), 1)
        covariance = inverse @ inverse.T * max(1.0, _square(residual) / freedom)
        hidden = [direction / scale for direction in vt[~seen]]
        for direction in hidden:
            unknown = np.abs(direction) * scale > 1e-3
            covariance[unknown] = covariance[:, unknown] = 0.0
            covariance[unknown, unknown] = np.inf
        return covariance, hidden


def _spread(count: int, dimensions: int, random: np.random.Generator) -> Array:
    """Return points (count, dimensions) of a Latin hypercube."""
    ranks = np.array([random.permutation(count) for _ in range(dimensions)]).T
    return (ranks + random.uniform(size=ranks.shape)) / count


def _square(residual: Array) -> float:
    return float(np.sum(residual**2))
