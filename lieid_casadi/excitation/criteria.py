"""Excitation criteria: functions of the base regressor's Gram matrix G = YᵀY."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExcitationError
from lieid_casadi.model import Model

ScalingName = Literal["si", "units", "prior", "unit_norm"]
SCALINGS: tuple[ScalingName, ...] = get_args(ScalingName)
LEAST_SIZE = 0.01  # of a group's typical size: prior deviation of a parameter stated as 0


def column_scale(model: Model, scaling: ScalingName | Sequence[float] | Array) -> Array | None:
    """Return the factors (P,) of the full regressor's columns; None for ``unit_norm``.

    Parameters
    ----------
    model : Model
    scaling : str or (P,)
        ``si``: factors of one. ``units``: units from the arm's own mass and length, and for
        friction from typical torques of its joints. ``prior``: the sizes of the stated parameters
        as prior standard deviations, for friction again typical torques. ``unit_norm``: columns of
        the base regressor scaled to unit norm, which depends on the trajectory.

    Raises
    ------
    ExcitationError
        Unknown name, wrong number of factors, factors that are not positive.
    """
    count = len(model.base.names)
    if not isinstance(scaling, str):
        factors = np.asarray(scaling, dtype=float)
        if factors.shape != (count,) or not np.all(np.isfinite(factors) & (factors > 0.0)):
            raise ExcitationError(
                f"scaling: expected {count} positive factors, one per column of the full regressor"
            )
        return factors
    if scaling == "unit_norm":
        return None
    if scaling == "si":
        return np.ones(count)
    if scaling not in SCALINGS:
        raise ExcitationError(f"scaling: {scaling!r}; expected {', '.join(SCALINGS)} or factors")
    links = model.robot.link_parameters.reshape(model.n, 10)
    groups = (slice(0, 1), slice(1, 4), slice(4, 10))
    scale = np.empty_like(links)
    for group in groups:
        typical = np.sqrt(np.mean(links[:, group] ** 2))
        if scaling == "units":
            scale[:, group] = typical
        else:
            scale[:, group] = np.maximum(np.abs(links[:, group]), LEAST_SIZE * typical)
    return np.concatenate([scale.ravel(), _friction_scale(model)])


def _friction_scale(model: Model) -> Array:
    """Return a few per cent of each joint's torque limit, per effect coefficient's unit of 1."""
    torque = model.robot.limit("torque")
    typical = np.where(np.isfinite(torque), 0.03 * torque, 1.0)
    return np.array([typical[column.joint] for column in model.columns])


CriterionExpression = Callable[[ca.SX], ca.SX]
SMALLEST = 1e-14  # of the largest eigenvalue; smaller ones are replaced by it


class Criterion(ABC):
    """A function of G (p, p) to be minimized, with its derivative."""

    name: ClassVar[str]

    @abstractmethod
    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """Return the value and its derivative ∂f/∂G (p, p), symmetric."""


@dataclass(frozen=True, eq=False)
class Condition(Criterion):
    """Condition number of the full regressor, smoothed (C2).

    The extreme eigenvalues λ of the full regressor's Gram matrix are not smooth where they meet.
    (1/2p)·[log Σλᵖ + log Σλ⁻ᵖ] is, bounds log cond from above and comes within (log r)/p of it.

    Attributes
    ----------
    metric : (p, p)
        L with LLᵀ = K·D²·Kᵀ (K the base combination, D the column scales): the eigenvalues of
        LᵀGL are the nonzero ones of the full scaled regressor's Gram matrix.
    power : float
        p; with a small one all directions contribute, with a large one the extremes.
    """

    metric: Array
    power: float
    name = "condition"

    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """See `Criterion`."""
        sizes, vectors = np.linalg.eigh(self.metric.T @ gram @ self.metric)
        sizes = np.maximum(sizes, SMALLEST * sizes[-1])
        p = self.power
        above, below = (sizes / sizes[-1]) ** p, (sizes[0] / sizes) ** p
        value = np.log(sizes[-1] / sizes[0]) + np.log(above.sum() * below.sum()) / p
        slopes = (above / above.sum() - below / below.sum()) / sizes
        turned = self.metric @ vectors
        return 0.5 * float(value), 0.5 * (turned * slopes) @ turned.T


@dataclass(frozen=True, eq=False)
class LogDet(Criterion):
    """−log det G / p (C4, D-optimality): the volume of the parameters' confidence region."""

    name = "logdet"

    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """See `Criterion`."""
        sizes, vectors = np.linalg.eigh(gram)
        sizes = np.maximum(sizes, SMALLEST * sizes[-1])
        count = len(sizes)
        return -float(np.mean(np.log(sizes))), -(vectors / (count * sizes)) @ vectors.T


@dataclass(frozen=True, eq=False)
class Hadamard(Criterion):
    """1/∏ of the base regressor's column norms, as a mean logarithm (C3).

    By Hadamard's inequality a lower bound of `LogDet` that needs no decomposition.
    """

    name = "hadamard"

    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """See `Criterion`."""
        norms = np.maximum(np.diag(gram), SMALLEST * np.trace(gram))
        return -0.5 * float(np.mean(np.log(norms))), np.diag(-0.5 / (len(norms) * norms))


@dataclass(frozen=True, eq=False)
class AOptimal(Criterion):
    """log tr (LᵀGL)⁻¹: the sum of the parameters' variances."""

    metric: Array
    name = "a_optimal"

    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """See `Criterion`."""
        sizes, vectors = np.linalg.eigh(self.metric.T @ gram @ self.metric)
        sizes = np.maximum(sizes, SMALLEST * sizes[-1])
        total = float(np.sum(1.0 / sizes))
        turned = self.metric @ vectors
        return float(np.log(total)), -(turned / (total * sizes**2)) @ turned.T


@dataclass(frozen=True, eq=False)
class EOptimal(Criterion):
    """−log λ_min(LᵀGL), smoothed as in `Condition`: the worst parameter direction's variance."""

    metric: Array
    power: float
    name = "e_optimal"

    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """See `Criterion`."""
        sizes, vectors = np.linalg.eigh(self.metric.T @ gram @ self.metric)
        sizes = np.maximum(sizes, SMALLEST * sizes[-1])
        below = (sizes[0] / sizes) ** self.power
        value = -np.log(sizes[0]) + np.log(below.sum()) / self.power
        turned = self.metric @ vectors
        return float(value), -(turned * (below / below.sum() / sizes)) @ turned.T


@dataclass(frozen=True, eq=False)
class UnitNormColumns(Criterion):
    """A criterion of the base regressor with columns scaled to unit norm.

    With R = D⁻¹GD⁻¹, D = diag(G)^½ and S = ∂f/∂R, the derivative is
    ∂f/∂G = D⁻¹SD⁻¹ − diag(SR)/diag(G).
    """

    criterion: Criterion

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the criterion."""
        return self.criterion.name

    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """See `Criterion`."""
        scaled = unit_norm_gram(gram)
        value, slope = self.criterion.evaluate(scaled)
        norms = np.sqrt(np.diag(gram))
        change = np.diag((slope * scaled).sum(axis=1) / norms**2)
        return value, slope / np.outer(norms, norms) - change


class ExpressionCriterion(Criterion):
    """A criterion of your own, as a CasADi expression of G (p, p); differentiated by CasADi.

    Parameters
    ----------
    expression : callable
        SX (p, p) → SX scalar.
    size : int
        p.

    Raises
    ------
    ExcitationError
        The expression is not a scalar.
    """

    def __init__(self, expression: CriterionExpression, size: int) -> None:
        gram = ca.SX.sym("G", size, size)
        value = ca.SX(expression(gram))
        if value.shape != (1, 1):
            raise ExcitationError(f"criterion: shape {value.shape}; expected a scalar expression")
        self.name = criterion_name(expression)  # type: ignore[misc]
        self._function = ca.Function("criterion", [gram], [value, ca.gradient(value, gram)])

    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """See `Criterion`."""
        value, slope = (output.full() for output in self._function(gram))
        return float(value[0, 0]), 0.5 * (slope + slope.T)


def criterion_name(criterion: str | CriterionExpression) -> str:
    """Return the name of a criterion in files and summaries."""
    return criterion if isinstance(criterion, str) else getattr(criterion, "__name__", "own")


def unit_norm_gram(gram: Array) -> Array:
    """Return the Gram matrix (p, p) of the same columns, scaled to unit norm."""
    norms = np.sqrt(np.diag(gram))
    return np.asarray(gram / np.outer(norms, norms))


@dataclass(frozen=True)
class CriterionStage:
    """Part of an optimization.

    Attributes
    ----------
    criterion : Criterion
    iterations : int
        At most.
    tolerance : float
        Decrease of the criterion below which the stage ends.
    """

    criterion: Criterion
    iterations: int
    tolerance: float = 1e-4


CriterionName = Literal["combined", "condition", "hadamard", "logdet", "a_optimal", "e_optimal"]
NAMES: tuple[CriterionName, ...] = get_args(CriterionName)
POWERS = (1.0, 2.0, 4.0, 8.0, 16.0, 64.0)
ITERATIONS = (30, 30, 40, 60, 60, 100)  # of each power
TOLERANCES = (1e-4, 1e-4, 1e-4, 1e-4, 3e-5, 3e-5)


def stages(name: str, metric: Array, *, unit_norm: bool = False) -> tuple[CriterionStage, ...]:
    """Return the stages of a criterion by its name; `make_plan` composes ``combined``.

    Parameters
    ----------
    name : str
        ``condition``, ``hadamard``, ``logdet``, ``a_optimal`` or ``e_optimal``.
    metric : (p, p)
        See `Condition`.
    unit_norm : bool
        Whether criteria with a metric take the base columns scaled to unit norm.

    Raises
    ------
    ExcitationError
        Unknown name.
    """

    def scaled(criterion: Criterion) -> Criterion:
        return UnitNormColumns(criterion) if unit_norm else criterion

    if name == "hadamard":
        return (CriterionStage(Hadamard(), 200, 1e-5),)
    if name == "logdet":
        return (CriterionStage(LogDet(), 200, 1e-5),)
    if name == "a_optimal":
        return (CriterionStage(LogDet(), 15), CriterionStage(scaled(AOptimal(metric)), 200, 1e-4))
    if name not in ("condition", "e_optimal"):
        raise ExcitationError(f"criterion: {name!r}; expected one of {', '.join(NAMES)}")
    smooth = Condition if name == "condition" else EOptimal
    return tuple(
        CriterionStage(scaled(smooth(metric, power)), count, tolerance)
        for power, count, tolerance in zip(POWERS, ITERATIONS, TOLERANCES, strict=True)
    )


@dataclass(frozen=True, eq=False)
class ObjectiveValue:
    """An objective at z: value, gradient (m,), G (p, p) and further limits excess ≤ 0.

    ``excess`` (s,) has the slopes (s, m); most objectives have none.
    """

    value: float
    gradient: Array
    gram: Array
    excess: Array
    slopes: Array
