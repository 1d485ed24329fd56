"""A friction model fitted to a friction curve by weighted least squares."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import qmc

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.compiled.triangular_factors import Triangle
from lieid_casadi.effects import ArmEffect, Effect, Placement
from lieid_casadi.effects.placement import place
from lieid_casadi.errors import (
    BoundWarning,
    EffectError,
    LieidWarning,
    NotDissipativeWarning,
    UnidentifiableWarning,
    warning_list,
)
from lieid_casadi.friction_curves.curve import FrictionCurve, friction_curve, plot_friction
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.regression.least_squares import Factor, solve
from lieid_casadi.identification.regression.variable_projection import (
    SeparableProblem,
    ShapeRange,
    forward_differences,
    minimize_shapes,
)
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.messages import in_unit
from lieid_casadi.model import Model, Parameter
from lieid_casadi.plot_style import Axes, Figure
from lieid_casadi.recording import Processing, Recording
from lieid_casadi.robot.robot import Robot
from lieid_casadi.tables import Table, html, make_table

DEFAULT = "coulomb,viscous,stribeck"  # with load_friction where the load varies
LONG_WAY = 1e3  # rad, after which effects with memory are in steady state
OTHER_SIGNALS = {"q", "ddq", "temperature", "time"}  # that a curve does not have
STARTS, DESCENTS = 200, 10  # values of the shapes that are tried, and local searches from the best
EVALUATIONS = 50  # of the residual in one local search
SCANNED, MOST_SCANS = 40, 5  # values of each shape beside the others; scans after a local search
BETTER = 1e-3  # relative fall of the cost by a scan, below which it is the last one
ZERO_COLUMN = 1e-9  # norm relative to the largest column below which a column counts as zero
INVOLVED = 1e-3  # scaled component of a direction without information that is part of it
NAMED = 0.05  # of a direction's largest component, above which a parameter is named
POINTS = 80  # speeds at which the sign of the friction is checked


def steady_columns(
    compiled: Compiled,
    joint: int,
    speed: ArrayLike,
    shapes: Array,
    *,
    load: ArrayLike = 0.0,
    position: ArrayLike = 0.0,
    time: float = 0.0,
) -> Array:
    """Return half the difference (P, m) of the effects' columns at +speed and −speed (P,)."""
    speeds = np.atleast_1d(np.asarray(speed, dtype=float))
    velocities = np.concatenate([speeds, -speeds])
    # two samples of each velocity, the first one far away: effects with memory reach steady state
    rows, n = 2 * len(velocities), compiled.n
    q, dq, forces = (np.zeros((rows, n)) for _ in range(3))
    dq[:, joint] = np.repeat(velocities, 2)
    q[:, joint] = np.repeat(np.tile(np.broadcast_to(position, speeds.shape), 2), 2)
    q[::2, joint] -= np.sign(velocities) * LONG_WAY
    forces[:, joint] = np.repeat(np.tile(np.broadcast_to(load, speeds.shape), 2), 2)
    columns = compiled.effect_columns(
        q,
        dq,
        0.0 * q,
        load=forces,
        temperature=np.zeros((rows, n)),
        time=np.full(rows, time),
        shapes=shapes,
        joint_effects_only=True,
    )[1::2, joint]
    return np.asarray(0.5 * (columns[: len(speeds)] - columns[len(speeds) :]))


@dataclass(frozen=True, eq=False)
class FrictionFit:
    """A friction model fitted to the curve of one joint."""

    curve: FrictionCurve
    model: Model  # the robot with the effects on that joint
    coefficients: Array  # (m,) linear coefficients, in the order of ``model.columns``
    shapes: Array  # (s,) shape parameters, in the order of ``model.shapes``
    #: (m + s, m + s) of both; infinite variance where the curve does not determine a parameter
    covariance: Array
    predicted: Array  # (G,) friction torque of the model at the curve's points, N·m
    warnings: tuple[LieidWarning, ...]

    @cached_property
    def compiled(self) -> Compiled:
        """The model's functions."""
        return compile(self.model)

    @property
    def effects(self) -> tuple[str, ...]:
        """Labels of the effects, without the joint."""
        return tuple(p.effect.label for p in self.model.placements)

    @property
    def rms(self) -> float:
        """RMS of measured − predicted friction over the points, N·m (section 6.4.2)."""
        return float(np.sqrt(np.mean((self.curve.friction - self.predicted) ** 2)))

    @property
    def correlation(self) -> float:
        """Correlation coefficient of measured and predicted friction (section 6.4.2)."""
        if np.ptp(self.curve.friction) == 0.0 or np.ptp(self.predicted) == 0.0:
            return float("nan")
        return float(np.corrcoef(self.curve.friction, self.predicted)[0, 1])

    @property
    def std(self) -> Array:
        """Standard deviations of coefficients and shapes (m + s,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coefficients, then shapes."""
        return (*self.model.columns, *self.model.shapes)

    def friction(self, speed: ArrayLike, *, load: ArrayLike = 0.0) -> Array:
        """Return the friction torque (P,), N·m, at positive speeds (P,), rad/s, and loads, N·m."""
        joint = self.curve.joint
        columns = steady_columns(self.compiled, joint, speed, self.shapes, load=load)
        return np.asarray(columns @ self.coefficients)

    def parameter_table(self) -> list[dict[str, Any]]:
        """Return one row per parameter: name, joint (from 1), value, std, unit."""
        values = np.concatenate([self.coefficients, self.shapes])
        return [
            {
                "name": p.name,
                "joint": p.joint + 1,
                "value": float(value),
                "std": number_or_none(std),
                "unit": p.unit,
            }
            for p, value, std in zip(self.parameters, values, self.std, strict=True)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return effects, parameters and goodness of fit for JSON."""
        return {
            "joint": self.curve.joint + 1,
            "effects": list(self.effects),
            "parameters": self.parameter_table(),
            "rms": self.rms,
            "correlation": number_or_none(self.correlation),
            "predicted": self.predicted.tolist(),
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the curve and the model at low and high load and return the figure."""
        curve = self.curve
        title = f"joint {curve.joint + 1} {curve.joint_name}: RMS {self.rms:.3g} {curve.unit}"
        if np.isfinite(self.correlation):
            title += f", correlation {self.correlation:.3f}"
        return plot_friction(
            curve.points, curve.unit, f"{title}\n{', '.join(self.effects)}",
            model=lambda speed, load: self.friction(speed, load=load), ax=ax,
        )  # fmt: skip

    def _repr_html_(self) -> str:
        return html(parameter_table(self))

    def __repr__(self) -> str:
        return (
            f"<FrictionFit of {self.curve.joint_name}: {', '.join(self.effects)}; "
            f"RMS error {self.rms:.3g} {self.curve.unit}>"
        )


def parameter_table(fit: FrictionFit) -> Table:
    """Return the parameters of a friction model fitted to a curve."""
    return make_table(
        f"Joint {fit.curve.joint + 1}, {', '.join(fit.effects)}: RMS {fit.rms:.3g} "
        f"{fit.curve.unit}, correlation {fit.correlation:.4f}",
        ("parameter", "value", "std", "unit"),
        [(row["name"], row["value"], row["std"], row["unit"]) for row in fit.parameter_table()],
    )


def fit_friction(
    curve: FrictionCurve, effects: str | Iterable[str | Effect] | None = None
) -> FrictionFit:
    """Fit a friction model to a friction curve, weighted by the standard errors of its points.

    Shape parameters are searched within their bounds by trust-region least squares from the best of
    many starting points; the linear coefficients follow for each of them by bounded linear least
    squares (variable projection).

    ``effects``: effects of speed and load, such as ``"coulomb,viscous,load_friction"``; by default
    Coulomb, viscous and Stribeck friction, and load friction where the load varies.
    """
    model = Model.of_placements(curve.robot, _placements(curve, effects))
    compiled, ranges = compile(model), ShapeRange.of(model.shapes)
    weight = 1.0 / np.maximum(curve.std, 1e-3 * np.median(curve.std) + 1e-12)

    def columns(shapes: Array) -> Array:
        return steady_columns(compiled, curve.joint, curve.speed, shapes, load=curve.load)

    lower, upper = (
        np.array([getattr(c, end) for c in model.columns]) for end in ("lower", "upper")
    )
    problem = SeparableProblem(
        columns=lambda shapes: weight[:, None] * columns(shapes),
        target=weight * curve.friction,
        ranges=ranges,
        bounds=(lower, upper),
        negligible=ZERO_COLUMN,
    )
    shapes = _best_shapes(problem, model.initial_shapes)
    coefficients = problem.solve(shapes).coefficients
    predicted = columns(shapes) @ coefficients
    slopes = forward_differences(columns, ranges, shapes, coefficients)
    residual = weight * (curve.friction - predicted)
    matrix = weight[:, None] * np.column_stack([columns(shapes), slopes])
    covariance, hidden = _covariance(matrix, residual)
    fit = FrictionFit(curve, model, coefficients, shapes, covariance, predicted, ())
    found = (*_bounds(fit), *_not_identifiable(fit, hidden), *_negative(fit))
    return replace(fit, warnings=found)


def _placements(
    curve: FrictionCurve, effects: str | Iterable[str | Effect] | None
) -> tuple[Placement, ...]:
    if effects is None:
        effects = f"{DEFAULT},load_friction" if curve.load_varies else DEFAULT
    if isinstance(effects, str):
        effects = [name for name in effects.split(",") if name.strip()]
    n, joint = curve.robot.n, curve.joint
    placed: list[Placement] = []
    for spec in effects:
        own_joints = isinstance(spec, str) and ":" in spec
        placed += place(spec, n) if own_joints else place(spec, n, [joint])
    if not placed:
        raise EffectError("no effects given; expected e.g. coulomb,viscous")
    for p in placed:
        if p.joint != joint or p.source is not None:
            raise EffectError(f"effect {p.label} does not act on joint {joint + 1} of the curve")
        # effects with memory are in steady state on a curve
        elsewhere = bool(OTHER_SIGNALS & set(p.effect.signals)) and not p.effect.states
        if isinstance(p.effect, ArmEffect) or elsewhere:
            raise EffectError(
                f"{p.effect.label} is not friction of speed and load; use identify instead"
            )
    return tuple(placed)


def _best_shapes(problem: SeparableProblem, initial: Array) -> Array:
    """Return the shapes (s,) of the best of several local searches.

    From the end of each every shape is scanned over its whole range beside the others and searched
    again from the best value, until it is no better: a shape may hide in a part of it.
    """
    if not len(initial):
        return initial

    def found(start: Array) -> Array:
        best = minimize_shapes(problem, start, max_evaluations=EVALUATIONS)
        for _ in range(MOST_SCANS):
            start = min(_scanned(problem.ranges, best), key=problem.cost)
            moved = minimize_shapes(problem, start, max_evaluations=EVALUATIONS)
            if problem.cost(moved) > (1.0 - BETTER) * problem.cost(best):
                break
            best = moved
        return best

    places = qmc.Halton(len(initial), scramble=False).random(STARTS + 1)[1:]
    starts = sorted([initial, *problem.ranges.shapes(places)], key=problem.cost)[:DESCENTS]
    return min(map(found, starts), key=problem.cost)


def _scanned(ranges: ShapeRange, shapes: Array) -> Array:
    """Return shapes (s · SCANNED, s) with each of them in turn anywhere in its range."""
    places = np.repeat(ranges.place(shapes)[None], len(shapes) * SCANNED, axis=0)
    for k, own in enumerate(np.split(places, len(shapes))):
        own[:, k] = np.linspace(0.0, 1.0, SCANNED)
    return ranges.shapes(places)


def _covariance(matrix: Array, residual: Array) -> tuple[Array, tuple[Array, ...]]:
    """Return the covariance (m + s, m + s) and the directions that are not determined."""
    scale = np.linalg.norm(matrix, axis=0)
    zero = scale <= ZERO_COLUMN * scale.max(initial=0.0)
    scale[zero] = 1.0
    triangle = Triangle(matrix.shape[1] + 1)
    triangle.add(np.where(zero, 0.0, matrix / scale), residual)
    solution = solve(Factor(triangle.r, len(matrix)))
    freedom = max(len(matrix) - matrix.shape[1] + len(solution.unexcited), 1)
    dispersion = max(1.0, float(residual @ residual) / freedom)
    covariance = dispersion * solution.unit_covariance / np.outer(scale, scale)
    for direction in solution.unexcited:
        unknown = np.abs(direction) > INVOLVED * np.abs(direction).max()
        covariance[unknown] = covariance[:, unknown] = 0.0
        covariance[unknown, unknown] = np.inf
    return covariance, tuple(direction / scale for direction in solution.unexcited)


def _bounds(fit: FrictionFit) -> Iterator[LieidWarning]:
    """Warn of parameters at their bounds."""
    at_bound = ShapeRange.of(fit.model.shapes).at_bound(fit.shapes)
    for shape, value, at_end in zip(fit.model.shapes, fit.shapes, at_bound, strict=True):
        if at_end:
            yield BoundWarning(
                f"{shape.label} is at its bound {in_unit(f'{value:.3g}', shape.unit)} (range "
                f"{shape.lower:g} to {shape.upper:g}); the curve shows little of this effect"
            )
    for column, value in zip(fit.model.columns, fit.coefficients, strict=True):
        if np.isclose(value, column.lower) or np.isclose(value, column.upper):
            size = in_unit(f"{value:.3g}", column.unit)
            yield BoundWarning(f"{column.label} is at its bound {size}")


def _not_identifiable(fit: FrictionFit, hidden: Sequence[Array]) -> Iterator[LieidWarning]:
    """Warn of parameters that the curve does not determine, or less than by their value."""
    for direction in hidden:
        part = np.abs(direction) / np.abs(direction).max()
        names = [p.label for p, x in zip(fit.parameters, part, strict=True) if x > NAMED]
        what = (
            f"{names[0]} cannot be identified"
            if len(names) == 1
            else f"{', '.join(names)} cannot be separated"
        )
        yield UnidentifiableWarning(f"{what} by this curve")
    values = np.concatenate([fit.coefficients, fit.shapes])
    uncertain = np.isfinite(fit.std) & (fit.std > np.abs(values))
    names = [p.label for p, x in zip(fit.parameters, uncertain, strict=True) if x]
    if names:
        yield UnidentifiableWarning(
            f"{', '.join(names)}: the standard deviation exceeds the value; use a model with "
            "fewer parameters, or record more speeds and loads"
        )


def _negative(fit: FrictionFit) -> Iterator[LieidWarning]:
    """Warn of friction that drives the joint at some measured speed and load."""
    curve = fit.curve
    slowest, fastest = float(curve.speed.min()), float(curve.speed.max())
    speeds = np.tile(np.geomspace(slowest, fastest, POINTS), 2)
    loads = np.repeat([curve.load.min(), curve.load.max()], POINTS)
    if np.any(fit.friction(speeds, load=loads) < 0.0):
        yield NotDissipativeWarning(
            f"joint {curve.joint + 1}: the fitted friction is negative, that is, it drives the "
            f"joint, at some speed from {slowest:.3g} to {fastest:.3g} rad/s"
        )


def friction(
    arm: Robot | Fit,
    recordings: Recording | Sequence[Recording],
    joint: int,
    *,
    effects: str | Iterable[str | Effect] | None = None,
    processing: Processing | None = None,
) -> FrictionFit:
    """Fit a friction model to the motion of one joint in both directions (Eq. 15).

    ``arm``: source of link parameters: identified ones and armatures of a fit, or nominal ones;
    ``recordings``: with torques, in both directions of the joint; ``joint``: from 0; ``effects``:
    such as ``"coulomb,viscous,load_friction"``, by default Coulomb, viscous and Stribeck friction,
    and load friction where the load varies; ``processing``: filter options, by default the cut-off
    is chosen from the spectrum. The result's ``curve`` is the friction curve.
    Raises `RecordingError`: the joint does not pass the same positions in both directions.
    Raises `EffectError`: an effect is unknown or acts on another joint.
    """
    curve = friction_curve(arm, recordings, joint, processing=processing)
    return fit_friction(curve, effects)
