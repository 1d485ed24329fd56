"""Excitation criteria, and the information matrix G = YᵀY that they are functions of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import recursion
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.dynamics.regressor import regressor
from lieid_casadi.effects import Effect, Placement, place
from lieid_casadi.effects.arm_effect import ArmEffect
from lieid_casadi.effects.effect import EffectSignals
from lieid_casadi.errors import ExcitationError, NotCountedWarning
from lieid_casadi.excitation.sample_functions import (
    FittedArm,
    SampleKernel,
    load_parameters,
    reverse_derivative,
    shapes_of,
)
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.model import Model

CriterionExpression = Callable[[ca.SX], ca.SX]
CriterionName = Literal["combined", "condition", "hadamard", "logdet"]
NAMES: tuple[CriterionName, ...] = get_args(CriterionName)
SMALLEST = 1e-14  # of the largest eigenvalue; smaller ones are replaced by it


class Criterion(ABC):
    """A function of G (p, p) to be minimized, with its derivative; the name is that in files."""

    name: str

    @abstractmethod
    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """Return the value and its derivative ∂f/∂G (p, p), symmetric."""


@dataclass(frozen=True, eq=False)
class Condition(Criterion):
    """Condition number of the full regressor, smoothed (C2).

    The extreme eigenvalues λ of the full regressor's Gram matrix, which are the nonzero ones of
    LᵀGL with the ``metric`` L (LLᵀ = K·Kᵀ, K the base combination), are not smooth where they meet.
    (1/2p)·[log Σλᵖ + log Σλ⁻ᵖ] is, bounds log cond from above and comes within (log r)/p of it; p
    is the ``power``.
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


class LogDet(Criterion):
    """−log det G / p (C4, D-optimality): the volume of the parameters' confidence region."""

    name = "logdet"

    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """See `Criterion`."""
        sizes, vectors = np.linalg.eigh(gram)
        sizes = np.maximum(sizes, SMALLEST * sizes[-1])
        count = len(sizes)
        return -float(np.mean(np.log(sizes))), -(vectors / (count * sizes)) @ vectors.T


class Hadamard(Criterion):
    """1/∏ of the base regressor's column norms, as a mean logarithm (C3).

    By Hadamard's inequality a lower bound of `LogDet` that needs no decomposition.
    """

    name = "hadamard"

    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """See `Criterion`."""
        norms = np.maximum(np.diag(gram), SMALLEST * np.trace(gram))
        return -0.5 * float(np.mean(np.log(norms))), np.diag(-0.5 / (len(norms) * norms))


class ExpressionCriterion(Criterion):
    """A criterion of your own, as a CasADi expression of G (p, p); differentiated by CasADi."""

    def __init__(self, expression: CriterionExpression, size: int) -> None:
        gram = ca.SX.sym("G", size, size)
        value = ca.SX(expression(gram))
        if value.shape != (1, 1):
            raise ExcitationError(f"criterion: shape {value.shape}; expected a scalar expression")
        self.name = criterion_name(expression)
        self._function = ca.Function("criterion", [gram], [value, ca.gradient(value, gram)])

    def evaluate(self, gram: Array) -> tuple[float, Array]:
        """See `Criterion`."""
        value, slope = (output.full() for output in self._function(gram))
        return float(value[0, 0]), 0.5 * (slope + slope.T)


@dataclass(frozen=True)
class CriterionStage:
    """Part of an optimization: at most so many iterations, ended by a smaller decrease."""

    criterion: Criterion
    iterations: int
    tolerance: float


# power of the smooth condition number, most iterations, decrease that ends the stage
POWERS = (
    (1.0, 30, 1e-4), (2.0, 30, 1e-4), (4.0, 40, 1e-4), (8.0, 60, 1e-4), (16.0, 60, 3e-5),
    (64.0, 100, 3e-5),
)  # fmt: skip


def stages(
    criterion: str | CriterionExpression | Criterion, metric: Array
) -> tuple[CriterionStage, ...]:
    """Return the stages that lead to a criterion's optimum; a new criterion has its own here."""
    if criterion == "combined":  # the paper's C1 (Eq. 20): C3, then C2 with a bound on C4
        return (CriterionStage(Hadamard(), 60, 1e-5), *stages("condition", metric))
    if criterion == "condition":
        return tuple(
            CriterionStage(Condition(metric, power), count, tolerance)
            for power, count, tolerance in POWERS
        )
    if criterion == "hadamard":
        return (CriterionStage(Hadamard(), 200, 1e-5),)
    if criterion == "logdet":
        return (CriterionStage(LogDet(), 200, 1e-5),)
    if isinstance(criterion, str):
        raise ExcitationError(f"criterion: {criterion!r}; expected one of {', '.join(NAMES)}")
    if not isinstance(criterion, Criterion):
        criterion = ExpressionCriterion(criterion, len(metric))
    return (CriterionStage(LogDet(), 15, 1e-4), CriterionStage(criterion, 200, 1e-5))


def criterion_name(criterion: str | CriterionExpression | Criterion) -> str:
    """Return the name of a criterion in files and summaries."""
    if isinstance(criterion, Criterion):
        return criterion.name
    return criterion if isinstance(criterion, str) else getattr(criterion, "__name__", "own")


def design_model(model: Model) -> tuple[Model, tuple[NotCountedWarning, ...]]:
    """Return the model whose regressor a design evaluates, and a warning for what differs.

    Presliding is replaced by the dry friction that it becomes in sliding, and friction that falls
    with temperature by viscous friction at one temperature. Left out are effects of a measured
    temperature, which no trajectory chooses, other effects with memory, and effects on the whole
    arm or on the measurement.
    """
    kept: list[Placement] = []
    left_out: list[Placement] = []
    replaced: list[Placement] = []
    for placement in model.placements:
        others = placement.effect.counted_as
        if others:
            replaced.append(placement)
            kept += [new for name in others for new in place(name, model.n, [placement.joint])]
        elif follows_from_motion(placement.effect):
            kept.append(placement)
        else:
            left_out.append(placement)
    unique = {placement.label: placement for placement in kept}
    warnings = []
    if replaced:
        names = ", ".join(p.label for p in replaced)
        dry = sorted({name for p in replaced for name in p.effect.counted_as})
        warnings.append(
            NotCountedWarning(
                f"{names}: replaced by {' and '.join(dry)} in the regressor of the design"
            )
        )
    if left_out:
        names = ", ".join(p.label for p in left_out)
        warnings.append(
            NotCountedWarning(
                f"{names}: not in the regressor of the design, because the columns need "
                "temperature, memory, the whole arm or the measurement. Except for temperature, "
                "lieid discriminate designs a motion that separates them from other effects"
            )
        )
    return Model.of_placements(model.robot, tuple(unique.values())), tuple(warnings)


def follows_from_motion(effect: Effect) -> bool:
    """Return whether an effect's columns follow from the motion and the time of one instant."""
    has_memory = isinstance(effect, ArmEffect) or bool(effect.states)
    return not has_memory and "temperature" not in effect.signals and not effect.commanded


class InformationMatrix:
    """The base regressor of [Y, effect columns] along a motion, and gradients through it.

    The signs of velocities are smooth here, sgn(q̇) ≈ tanh(q̇/width), so that gradients exist. The
    quality of a design is evaluated with the model's own, sharp columns (see `quality`). Shape
    parameters, and link parameters for effects of the load, are those of the fit or the stated
    ones. Effects whose columns do not follow from the motion of one instant are refused.
    """

    def __init__(self, model: Model, *, sign_width: Array, fit: FittedArm | None = None) -> None:
        self.model = model
        symbols = Motion.symbols(model.n)
        time = ca.SX.sym("time")
        self._timed = any("time" in p.effect.signals for p in model.placements)
        further = {"time": time} if self._timed else {}
        matrix = base_regressor(model, symbols, sign_width, time, fit)
        self._values = SampleKernel("base_columns", symbols, matrix, further)
        seed = ca.SX.sym("seed", len(self._values.rows))
        # nonzeros in the kernel's order: row after row
        flat = ca.vertcat(
            *(
                matrix[int(i), int(j)]
                for i, j in zip(self._values.rows, self._values.columns, strict=True)
            )
        )
        reverse = reverse_derivative(flat, seed, symbols)
        self._reverse = SampleKernel(
            "base_columns_reverse", symbols, reverse, {"seed": seed, **further}
        )
        self._columns, self._rows = self._values.columns, self._values.rows
        self.size = model.base.count

    def rows(self, motion: MotionSamples) -> Array:
        """Return the base regressor of a motion, transposed (p, n·N): G is rows @ rows.T."""
        n, samples = self.model.n, len(motion)
        stacked = np.zeros((self.size, n, samples))
        stacked[self._columns, self._rows] = self._values.values(motion, **self._time(motion))
        return stacked.reshape(self.size, n * samples)

    def gradient(self, motion: MotionSamples, rows: Array, slope: Array) -> Array:
        """Return ∂f/∂(q, dq, ddq) (n, 3, N) of a function f(G) with the slope ∂f/∂G (p, p)."""
        n, samples = self.model.n, len(motion)
        seeds = (2.0 * slope @ rows).reshape(self.size, n, samples)
        seed = np.ascontiguousarray(seeds[self._columns, self._rows].T)
        reverse = self._reverse.dense(motion, seed=seed, **self._time(motion))
        return np.ascontiguousarray(reverse.reshape(3, n, samples).transpose(1, 0, 2))

    def _time(self, motion: MotionSamples) -> dict[str, Array]:
        return {"time": motion.t[:, None]} if self._timed else {}


def base_regressor(
    model: Model, symbols: Motion, sign_width: Array, time: ca.SX, fit: FittedArm | None = None
) -> ca.SX:
    """Return the base columns (n, p) of [Y, effect columns] with a smooth sign."""
    unreachable = [p.label for p in model.placements if not follows_from_motion(p.effect)]
    if unreachable:
        raise ExcitationError(
            f"{', '.join(unreachable)}: depends on temperature, the past or the whole arm, "
            "not on the motion of one instant; leave it out of the design"
        )
    n = model.n
    sign = ca.tanh(symbols.dq / ca.DM(sign_width))
    load = ca.SX(n, 1)
    if any("load" in p.effect.signals for p in model.placements):
        parameters = ca.SX(ca.DM(load_parameters(model, fit)))
        load = recursion.inverse_dynamics(model.robot, symbols, parameters)
    signals = EffectSignals(symbols.q, symbols.dq, symbols.ddq, sign, load, ca.SX(n, 1), time)
    shapes = ca.SX(ca.DM(shapes_of(model, fit)))
    every = ca.horzcat(regressor(model.robot, symbols), model.effect_columns(signals, shapes))
    return every[:, [int(k) for k in model.base.kept]]


@dataclass(frozen=True, eq=False)
class Quality:
    """How well the samples of a motion determine the parameters.

    Singular values (P,) are those of the stacked full regressor, SI, largest first; those beyond
    the structural rank are rounding. ``neg_log_det`` is that of the base Gram matrix (C4).
    """

    singular_values: Array
    rank: int
    neg_log_det: float

    @property
    def condition_number(self) -> float:
        """σ₁/σ_r."""
        return float(self.singular_values[0] / self.singular_values[self.rank - 1])


def quality(model: Model, motion: MotionSamples, fit: FittedArm | None = None) -> Quality:
    """Evaluate the model's own columns, sharp signs included, at samples of a motion."""
    base, full = stacked_regressors(model, motion, fit)
    sizes = np.linalg.svd(full, compute_uv=False)
    volume = float(np.linalg.slogdet(base.T @ base)[1])
    return Quality(np.asarray(sizes), model.base.count, -volume)


def stacked_regressors(
    model: Model, motion: MotionSamples, fit: FittedArm | None = None
) -> tuple[Array, Array]:
    """Return the base (N·n, p) and the full (N·n, P) regressor of a motion's samples."""
    from lieid_casadi.compiled import compile

    arm = compile(model)
    signals = motion.q, motion.dq, motion.ddq
    load = None
    if any("load" in p.effect.signals for p in model.placements):
        load = arm.inverse_dynamics(*signals, load_parameters(model, fit))
    columns = [arm.regressor(*signals)]
    if model.columns:
        shapes = shapes_of(model, fit)
        columns.append(arm.effect_columns(*signals, load=load, time=motion.t, shapes=shapes))
    full = np.concatenate(columns, axis=2).reshape(-1, len(model.base.names))
    return np.ascontiguousarray(full[:, model.base.kept]), full
