"""A friction model fitted to a friction curve: bounds, several starts, the effects' columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear

from lieid_casadi.compiled import compile
from lieid_casadi.effects import Effect, Placement
from lieid_casadi.effects.friction_models import FRICTION_MODELS
from lieid_casadi.effects.placement import place
from lieid_casadi.errors import (
    BoundWarning,
    EffectError,
    ExtrapolationWarning,
    LieidWarning,
    NotDissipativeWarning,
    UnidentifiableWarning,
)
from lieid_casadi.friction_curves.curve import FrictionCurve
from lieid_casadi.friction_curves.friction_fit import FrictionFit
from lieid_casadi.identification.regression.shape_range import ShapeRange
from lieid_casadi.model import Model, Parameter

Array = NDArray[np.float64]
SAMPLED_STARTS = 40  # shapes drawn over their ranges, of which the best are descended from
DESCENTS = 4
FINALISTS = 2  # of them, that are followed on all instants
SETTLED = 1e-4  # relative change of the misfit on all instants: far below what noise does to it
STEP = 1e-5  # of a shape's range
UNSEEN = 1e-9  # of the largest column: nothing of a column is left in half the difference
FAR = 0.5  # of the largest measured friction: further out, an extrapolation is told
RANK = 1e-7  # of scaled directions, below which the curve does not show one


def fit_friction(
    curve: FrictionCurve,
    effects: str | Iterable[str | Effect],
    *,
    starts: int = DESCENTS,
    seed: int = 0,
) -> FrictionFit:
    """Fit effects on the curve's joint to its points, weighted by their standard errors.

    Shapes are searched by trust-region least squares within their bounds from the best of many
    drawn starts; for each of them the linear coefficients follow by bounded linear least squares
    (variable projection). Columns are matched and averaged as the torque is.

    Parameters
    ----------
    curve : FrictionCurve
    effects : str or sequence of str or Effect
        The name of a friction model (`FRICTION_MODELS`), or effects without joints or with the
        curve's own: ``"coulomb,viscous,load_friction"``.
    starts : int
        Descents.
    seed : int
        Of the drawn starts.

    Raises
    ------
    EffectError
        Unknown effect, one that acts on or from another joint, or one that needs a temperature
        that the recordings lack.
    """
    problem = _Problem(curve, _placements(curve, effects))
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
    told = [*_bounds(problem, coefficients, shapes), *_unseen(problem, hidden)]
    return fit.with_warnings([*told, *_loose(fit), *_energy(fit)])


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
                f"{p.effect.label} is not friction of one joint; fit it with identify"
            )
        if p.joint != joint or p.source is not None:
            raise EffectError(f"effect {p.label} is not of joint {joint + 1}, whose curve this is")
        if "temperature" in p.effect.signals and not curve.data.has_temperature:
            raise EffectError(f"{p.effect.label} needs temperature; expected columns temp1…temp{n}")
    return tuple(placed)


class _Problem:
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
        scale[scale <= UNSEEN * scale.max(initial=0.0)] = np.inf
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
        enough = 1e-8 if thinned else SETTLED
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
        scale[scale <= UNSEEN * scale.max(initial=0.0)] = 1.0
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


def _bounds(problem: _Problem, coefficients: Array, shapes: Array) -> list[LieidWarning]:
    found: list[LieidWarning] = []
    stuck = problem.ranges.at_bound(shapes)
    for shape, value, at_end in zip(problem.model.shapes, shapes, stuck, strict=True):
        if at_end:
            found.append(
                BoundWarning(
                    f"{shape.label} ran to its bound {value:.3g} {shape.unit} (range "
                    f"{shape.lower:g} to {shape.upper:g}); its effect is hardly there"
                )
            )
    for column, value in zip(problem.model.columns, coefficients, strict=True):
        if np.isclose(value, column.lower) or np.isclose(value, column.upper):
            found.append(BoundWarning(f"{column.label} is at its bound {value:.3g} {column.unit}"))
    return found


def _unseen(problem: _Problem, hidden: Sequence[Array]) -> list[LieidWarning]:
    """Tell parameters that half the difference of both ways does not show."""
    parameters: list[Parameter] = [*problem.model.columns, *problem.model.shapes]
    found: list[LieidWarning] = []
    for direction in hidden:
        share = np.abs(direction) / np.abs(direction).max()
        names = [p.label for p, x in zip(parameters, share, strict=True) if x > 0.05]
        what = f"{names[0]} is" if len(names) == 1 else f"{', '.join(names)} together are"
        found.append(UnidentifiableWarning(f"{what} not seen in this curve"))
    return found


def _loose(fit: FrictionFit) -> list[LieidWarning]:
    """Tell parameters whose standard deviation exceeds their value."""
    values = np.concatenate([fit.coefficients, fit.shapes])
    loose = np.isfinite(fit.std) & (fit.std > np.abs(values))
    names = [p.label for p, x in zip(fit.parameters, loose, strict=True) if x]
    if not names:
        return []
    return [
        UnidentifiableWarning(
            f"{', '.join(names)}: standard deviation above the value itself; a model with fewer "
            "parameters says the same, or runs over more speeds and loads say more"
        )
    ]


def _energy(fit: FrictionFit) -> list[LieidWarning]:
    """Tell where the fitted friction drives the joint, or runs off where nothing was measured."""
    curve, unit = fit.curve, fit.curve.unit
    slowest, fastest = float(curve.speed.min()), float(curve.speed.max())
    speeds = np.geomspace(0.05 * slowest, fastest, 80)
    loads = np.array([curve.load.min(), curve.load.max()])
    friction = fit.friction(np.tile(speeds, 2), load=np.repeat(loads, len(speeds)))
    below = np.tile(speeds, 2) < slowest
    most = float(np.abs(curve.friction).max())
    found: list[LieidWarning] = []
    if np.any(friction[~below] < 0.0):
        found.append(
            NotDissipativeWarning(
                f"joint {curve.joint + 1}: the fitted friction drives the joint at some speed "
                f"from {slowest:.3g} to {fastest:.3g} rad/s"
            )
        )
    worst = friction[below][np.argmax(np.abs(friction[below] - 0.5 * most))]
    if not -FAR * most < worst < (1.0 + FAR) * most:
        found.append(
            ExtrapolationWarning(
                f"joint {curve.joint + 1}: below {slowest:.3g} rad/s, where nothing was measured, "
                f"the fitted friction runs to {worst:.3g} {unit} (measured: at most {most:.3g}); "
                "record slower motion or take a model with fewer parameters"
            )
        )
    return found
