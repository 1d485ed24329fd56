"""Fit of a friction model to a friction curve, with bounds and several starting points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import compile
from lieid_casadi.effects import Effect, Placement
from lieid_casadi.effects.friction_models import FRICTION_MODELS
from lieid_casadi.effects.placement import place
from lieid_casadi.errors import EffectError
from lieid_casadi.friction_curves.curve import FrictionCurve
from lieid_casadi.friction_curves.friction_fit import FrictionFit
from lieid_casadi.friction_curves.friction_fit_warnings import friction_fit_warnings
from lieid_casadi.identification.regression.variable_projection import (
    SeparableProblem,
    ShapeRange,
    forward_differences,
    minimize_shapes,
)
from lieid_casadi.model import Model

SAMPLED_STARTS = 40  # random starting points, the best of which are used
DESCENTS = 4  # local searches
FINALISTS = 2  # of them that are continued on all instants
CONVERGED = 1e-4  # relative change of the cost on all instants, far below the effect of noise
EVALUATIONS = 50  # of the residual in one local search
ZERO_COLUMN = 1e-9  # norm relative to the largest column below which a column counts as zero
RANK = 1e-7  # relative singular value below which a direction is not determined by the curve
INVOLVED = 1e-3  # scaled component of such a direction that makes a parameter unknown


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

    ``effects``: name of a friction model (`FRICTION_MODELS`), or effects such as
    ``"coulomb,viscous,load_friction"``, without joint or with that of the curve; ``starts``: number
    of local searches, at least 1; ``seed``: seed of the random starting points.
    Raises `EffectError`: an effect is unknown, acts on or from another joint, or needs a
    temperature that the recordings do not have. Raises `ValueError`: ``starts`` is below 1.
    """
    if starts < 1:
        raise ValueError(f"starts is {starts}; expected at least 1")
    problem = _CurveProblem(curve, _placements(curve, effects))
    shapes = problem.search(starts, np.random.default_rng(seed))
    coefficients = problem.all_instants.solve(shapes).coefficients
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
        self.all_instants = self._separable(thinned=False)
        self.some_instants = self._separable(thinned=True)

    def _separable(self, *, thinned: bool) -> SeparableProblem:
        return SeparableProblem(
            columns=lambda shapes: self.weight[:, None] * self.columns(shapes, thinned=thinned),
            target=self.weight * self.curve.friction,
            ranges=self.ranges,
            bounds=(
                np.array([c.lower for c in self.model.columns]),
                np.array([c.upper for c in self.model.columns]),
            ),
            negligible=ZERO_COLUMN,
        )

    def columns(self, shapes: Array, *, thinned: bool = False) -> Array:
        """Return the columns averaged per point (G, m)."""
        data, joint = self.curve.data, self.curve.joint
        return data.columns(self.compiled, joint, shapes, thinned=thinned)

    def search(self, starts: int, random: np.random.Generator) -> Array:
        """Return the best shapes (s,), searched on a subset of the instants, then on all."""
        initial = self.model.initial_shapes
        if not len(initial):
            return initial
        cost = self.some_instants.cost
        drawn = self.ranges.shapes(_latin_hypercube(SAMPLED_STARTS, len(initial), random))
        best = sorted([initial, *drawn], key=cost)[:starts]
        found = sorted(
            (minimize_shapes(self.some_instants, x, max_evaluations=EVALUATIONS) for x in best),
            key=cost,
        )
        final = [
            minimize_shapes(self.all_instants, x, ftol=CONVERGED, max_evaluations=EVALUATIONS)
            for x in found[:FINALISTS]
        ]
        return min(final, key=self.all_instants.cost)

    def covariance(self, shapes: Array, coefficients: Array) -> tuple[Array, list[Array]]:
        """Return the covariance (m + s, m + s) and the directions that are not determined.

        Parameters of these directions have infinite variance.
        """
        slopes = forward_differences(self.columns, self.ranges, shapes, coefficients)
        matrix = self.weight[:, None] * np.column_stack([self.columns(shapes), slopes])
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale <= ZERO_COLUMN * scale.max(initial=0.0)] = 1.0
        _, sizes, vt = np.linalg.svd(matrix / scale, full_matrices=True)
        sizes = np.pad(sizes, (0, len(vt) - len(sizes)))
        determined = sizes > RANK * sizes[0]
        inverse = vt[determined].T / sizes[determined] / scale[:, None]
        freedom = max(len(matrix) - int(determined.sum()), 1)
        dispersion = max(1.0, self.all_instants.cost(shapes) / freedom)
        covariance = inverse @ inverse.T * dispersion
        hidden = [direction / scale for direction in vt[~determined]]
        for direction in hidden:
            unknown = np.abs(direction) * scale > INVOLVED
            covariance[unknown] = covariance[:, unknown] = 0.0
            covariance[unknown, unknown] = np.inf
        return covariance, hidden


def _latin_hypercube(count: int, dimensions: int, random: np.random.Generator) -> Array:
    """Return points (count, dimensions) between 0 and 1."""
    ranks = np.array([random.permutation(count) for _ in range(dimensions)]).T
    return (ranks + random.uniform(size=ranks.shape)) / count
