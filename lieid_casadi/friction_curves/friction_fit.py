"""Friction models fitted to a friction curve, with bounds and several starting points; ranked."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.effects import Effect, Placement, make
from lieid_casadi.effects.friction_models import FRICTION_MODELS, FrictionModel, friction_model
from lieid_casadi.effects.placement import place
from lieid_casadi.errors import (
    BoundWarning,
    EffectError,
    ExtrapolationWarning,
    LieidWarning,
    NotDissipativeWarning,
    UnidentifiableWarning,
    warning_list,
)
from lieid_casadi.friction_curves.curve import FrictionCurve, LoadSource, friction_curve
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.regression.variable_projection import (
    SeparableProblem,
    ShapeRange,
    forward_differences,
    minimize_shapes,
)
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.model import Model, Parameter
from lieid_casadi.recording import Processing, Recording
from lieid_casadi.robot.robot import Robot
from lieid_casadi.tables import Table, html, make_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


LONG_WAY = 1e3  # rad, after which effects with memory are in steady state


def steady_columns(
    compiled: Compiled,
    joint: int,
    speed: ArrayLike,
    shapes: Array,
    *,
    load: ArrayLike = 0.0,
    temperature: ArrayLike = 0.0,
    position: ArrayLike = 0.0,
    time: float = 0.0,
) -> Array:
    """Return half the difference of the effects' columns at +speed and −speed.

    ``compiled``: functions of a model with n joints and m effect columns; ``joint``: moving joint,
    from 0; the others are at rest; ``speed`` (P,): positive speeds, rad/s; ``shapes`` (s,): shape
    parameters of the model's effects; ``load`` (P,): load torque of the joint, N·m; ``temperature``
    (P,): °C relative to the mean of the training recordings; ``position`` (P,): joint position,
    rad; ``time``: time since the start of the recording, s.
    """
    speeds = np.atleast_1d(np.asarray(speed, dtype=float))
    velocities = np.concatenate([speeds, -speeds])
    # two samples of each velocity, the first one far away: effects with memory reach steady state
    rows, n = 2 * len(velocities), compiled.n
    q, dq, forces, temperatures = (np.zeros((rows, n)) for _ in range(4))
    dq[:, joint] = np.repeat(velocities, 2)
    q[:, joint] = np.repeat(np.tile(np.broadcast_to(position, speeds.shape), 2), 2)
    q[::2, joint] -= np.sign(velocities) * LONG_WAY
    forces[:, joint] = np.repeat(np.tile(np.broadcast_to(load, speeds.shape), 2), 2)
    temperatures[:, joint] = np.repeat(np.tile(np.broadcast_to(temperature, speeds.shape), 2), 2)
    columns = compiled.effect_columns(
        q,
        dq,
        0.0 * q,
        load=forces,
        temperature=temperatures,
        time=np.full(rows, time),
        shapes=shapes,
        joint_effects_only=True,
    )[1::2, joint]
    return np.asarray(0.5 * (columns[: len(speeds)] - columns[len(speeds) :]))


@dataclass(frozen=True, eq=False)
class FrictionFit:
    """A friction model fitted to the curve of one joint.

    Attributes
    ----------
    curve : FrictionCurve
    model : Model
        The robot with the effects on that joint.
    coefficients : (m,)
        Linear coefficients, in the order of ``model.columns``.
    shapes : (s,)
        Shape parameters, in the order of ``model.shapes``.
    covariance : (m + s, m + s)
        Covariance of both; infinite variance where the curve does not determine a parameter.
    predicted : (G,)
        Friction torque of the model at the curve's points, N·m.
    warnings : tuple of LieidWarning
    """

    curve: FrictionCurve
    model: Model
    coefficients: Array
    shapes: Array
    covariance: Array
    predicted: Array
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
    def bic(self) -> float:
        """Bayesian information criterion up to a constant of the curve; smaller is better."""
        count = len(self.curve)
        weighted = (self.curve.friction - self.predicted) / self.curve.std
        square = float(np.mean(weighted**2))
        free = len(self.coefficients) + len(self.shapes)
        return float(count * np.log(max(square, 1e-300)) + free * np.log(count))

    @property
    def std(self) -> Array:
        """Standard deviations of coefficients and shapes (m + s,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coefficients, then shapes."""
        return (*self.model.columns, *self.model.shapes)

    def friction(
        self,
        speed: ArrayLike,
        *,
        load: ArrayLike = 0.0,
        temperature: ArrayLike = 0.0,
        position: ArrayLike = 0.0,
    ) -> Array:
        """Return the friction torque at constant speeds.

        Parameters
        ----------
        speed : (P,)
            Positive speeds, rad/s.
        load : (P,) or float
            Load torque, N·m.
        temperature : (P,) or float
            °C relative to the mean of the recordings.
        position : (P,) or float
            Joint position, rad.

        Returns
        -------
        (P,)
            N·m.
        """
        columns = steady_columns(
            self.compiled,
            self.curve.joint,
            speed,
            self.shapes,
            load=load,
            temperature=temperature,
            position=position,
        )
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
            "bic": self.bic,
            "predicted": self.predicted.tolist(),
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the curve and the model at low and high load and return the figure."""
        from lieid_casadi.friction_curves.plots import plot_friction

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


PART = 0.05  # of a direction's largest component, above which a parameter is named
FAR = 0.5  # of the largest measured friction, by which an extrapolation may leave its range
SLOWEST = 0.05  # of the slowest measured speed, down to which the extrapolation is checked
POINTS = 80  # speeds


def friction_fit_warnings(fit: FrictionFit, hidden: Sequence[Array]) -> tuple[LieidWarning, ...]:
    """Return warnings of parameters at bounds or not identifiable, and of implausible friction."""
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


Progress = Callable[[str, float], None]
# a curve contains neither the offset nor the difference between motoring and generating
STATED = (
    "load_constant", "load_absolute", "load_square", "stribeck", "tustin", "simplified", "eq7",
    "paper", "gao2017", "gao2017_constant_temperature", "he2021", "madsen2020", "panda_sigmoid",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class RankedFrictionModel:
    """A friction model of the literature and its fit to a curve."""

    model: FrictionModel
    fit: FrictionFit


def rank_friction_models(
    curve: FrictionCurve,
    names: Sequence[str] = STATED,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[RankedFrictionModel, ...]:
    """Fit friction models to a curve and rank them by the Bayesian information criterion (BIC).

    Models that need a temperature are left out if the recordings have none. Differences of the
    BIC below about 6 are not strong evidence (Kass, Raftery, JASA 1995).

    ``names``: names of models in `FRICTION_MODELS`; ``seed``: seed of the random starting points;
    ``progress``: called with the name of a model and the completed fraction (0 to 1).
    Raises `EffectError`: a model with this name does not exist.
    """
    models = [friction_model(name) for name in names]
    fitting = [m for m in models if curve.data.has_temperature or not _needs_temperature(m)]
    found = []
    for k, model in enumerate(fitting):
        if progress is not None:
            progress(model.name, k / len(fitting))
        found.append(RankedFrictionModel(model, fit_friction(curve, model.effects, seed=seed)))
    return tuple(sorted(found, key=lambda ranked: ranked.fit.bic))


def _needs_temperature(model: FrictionModel) -> bool:
    return any("temperature" in make(effect).signals for effect in model.effects)


def ranking_table(ranked: Sequence[RankedFrictionModel]) -> Table:
    """Return friction models in the order of the Bayesian information criterion (BIC).

    Models are named by their form; an asterisk marks those with a note.
    """
    best, unit = ranked[0].fit.bic, ranked[0].fit.curve.unit
    return make_table(
        "Friction models, by the Bayesian information criterion (BIC)",
        (
            "model",
            f"RMS, {unit}",
            "correlation",
            "BIC above the best",
            "parameters",
            "source (name)",
        ),
        [
            (
                ranked_model.model.form + ("*" if ranked_model.model.note else ""),
                ranked_model.fit.rms,
                f"{ranked_model.fit.correlation:.4f}",
                f"{ranked_model.fit.bic - best:.1f}",
                len(ranked_model.fit.parameters),
                f"{ranked_model.model.credit} ({ranked_model.model.name})",
            )
            for ranked_model in ranked
        ],
    )


def friction(
    arm: Robot | Fit,
    recordings: Recording | Sequence[Recording],
    joint: int,
    *,
    effects: str | Iterable[str | Effect] | None = None,
    processing: Processing | None = None,
    load: LoadSource | None = None,
    seed: int = 0,
) -> FrictionFit:
    """Fit a friction model to the motion of one joint in both directions (Eq. 15).

    The steps are `lieid_casadi.friction_curves.friction_curve`, and `fit_friction` or
    `rank_friction_models` of that package.

    Parameters
    ----------
    arm : Robot or Fit
        Source of link parameters: identified ones and armatures of a fit, or nominal ones.
    recordings : Recording or sequence of Recording
        Recordings with torques.
    joint : int
        From 0.
    effects : str or sequence of str or Effect, optional
        Name of a friction model, or effects such as ``"coulomb,viscous,load_friction"``. Without
        it, the models of the literature are fitted and that with the smallest BIC is returned.
    processing : Processing, optional
        Filter options; by default the cut-off is chosen from the spectrum.
    load : {"model", "measured"}, optional
        Source of the load that friction may depend on, see `friction_curve`.
    seed : int
        Seed of the random starting points.

    Returns
    -------
    FrictionFit
        Its ``curve`` is the friction curve.

    Raises
    ------
    RecordingError
        The joint does not pass the same positions in both directions.
    EffectError
        An effect is unknown or acts on another joint.
    """
    curve = friction_curve(arm, recordings, joint, processing=processing, load=load)
    if effects is None:
        return rank_friction_models(curve, seed=seed)[0].fit
    return fit_friction(curve, effects, seed=seed)
