"""What a motion shows of the parameters: the regressor of a design and its quality."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.dynamics import recursion
from lieid_casadi.dynamics.lie import Motion as Symbols
from lieid_casadi.dynamics.regressor import regressor
from lieid_casadi.effects import Effect, Placement, place
from lieid_casadi.effects.arm_effect import ArmEffect
from lieid_casadi.effects.signals import EffectSignals
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


def design_model(model: Model) -> tuple[Model, tuple[NotCountedWarning, ...]]:
    """Return the model whose regressor a design evaluates, and a warning for what differs.

    Presliding is replaced by the dry friction that it becomes in sliding, and friction that falls
    with temperature by viscous friction at one temperature. Left out are effects of a measured
    temperature, which no trajectory chooses, other effects with memory, and effects on the whole
    arm or on the measurement.
    """
    model.robot.require_numbers("excite")
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


@dataclass(frozen=True, eq=False)
class StackedRegressor:
    """Base regressor Y_b of N samples, transposed: rows (p, n·N), one per base parameter."""

    motion: MotionSamples
    rows: Array

    def gram(self) -> Array:
        """Return YᵀY (p, p)."""
        return np.asarray(self.rows @ self.rows.T)


class InformationMatrix:
    """The base regressor of [Y, effect columns] along a motion, and gradients through it.

    The signs of velocities are smooth here, sgn(q̇) ≈ tanh(q̇/width), so that gradients exist. The
    quality of a design is evaluated with the model's own, sharp columns (see `quality`).

    Parameters
    ----------
    model : Model
    sign_width : (n,)
        Width of the smooth sign, rad/s.
    fit : FittedArm, optional
        Shape parameters, and link parameters for effects of the load. Default: the stated ones.

    Raises
    ------
    ExcitationError
        An effect whose columns do not follow from the motion and the time of one instant; see
        `design_model`.
    """

    def __init__(self, model: Model, *, sign_width: Array, fit: FittedArm | None = None) -> None:
        self.model = model
        symbols = Symbols.symbols(model.n)
        time = ca.SX.sym("time")
        self._timed = any("time" in p.effect.signals for p in model.placements)
        further = {"time": time} if self._timed else {}
        matrix = base_regressor(model, symbols, sign_width, time, fit)
        kept = model.base.count
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
        self.size = kept

    def at(self, motion: MotionSamples) -> StackedRegressor:
        """Return the stacked base regressor of a motion."""
        n, samples = self.model.n, len(motion)
        stacked = np.zeros((self.size, n, samples))
        stacked[self._columns, self._rows] = self._values.values(motion, **self._time(motion))
        return StackedRegressor(motion, stacked.reshape(self.size, n * samples))

    def gradient(self, stacked: StackedRegressor, slope: Array) -> Array:
        """Return the gradient of a function f(G) with respect to the motion.

        Parameters
        ----------
        stacked : StackedRegressor
        slope : (p, p)
            ∂f/∂G, symmetric.

        Returns
        -------
        (n, 3, N)
            ∂f/∂(q, dq, ddq).
        """
        n, samples = self.model.n, len(stacked.motion)
        seeds = (2.0 * slope @ stacked.rows).reshape(self.size, n, samples)
        seed = np.ascontiguousarray(seeds[self._columns, self._rows].T)
        reverse = self._reverse.dense(stacked.motion, seed=seed, **self._time(stacked.motion))[
            :, 0, :
        ]
        return np.ascontiguousarray(reverse.reshape(3, n, samples).transpose(1, 0, 2))

    def _time(self, motion: MotionSamples) -> dict[str, Array]:
        return {"time": motion.t[:, None]} if self._timed else {}


def base_regressor(
    model: Model, symbols: Symbols, sign_width: Array, time: ca.SX, fit: FittedArm | None = None
) -> ca.SX:
    """Return the base columns (n, p) of [Y, effect columns] with a smooth sign.

    Parameters
    ----------
    model : Model
    symbols : Symbols
        Of the motion.
    sign_width : (n,)
        Width of the smooth sign, rad/s.
    time : SX
        Symbol of the time, s.
    fit : FittedArm, optional
        See `InformationMatrix`.
    """
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


NAMED = 3  # base parameters that name a weak direction
WEAK = 3  # directions that are reported
NAMED_SHARE = 0.1  # smallest part of a direction that is named


@dataclass(frozen=True)
class WeakDirection:
    """A direction of the parameters that changes the torques least.

    Attributes
    ----------
    singular_value : float
        Root sum of squares of the torques per unit of parameter along the direction.
    parameters : tuple of (str, float)
        Largest components among the base parameters: name, share in [−1, 1].
    """

    singular_value: float
    parameters: tuple[tuple[str, float], ...]

    @property
    def text(self) -> str:
        """E.g. ``0.9 Ixx7 − 0.4 Iyy7``."""
        first, *rest = self.parameters
        terms = [f"{first[1]:.2g} {first[0]}"]
        terms += [f"{'−' if share < 0 else '+'} {abs(share):.2g} {name}" for name, share in rest]
        return " ".join(terms)


@dataclass(frozen=True, eq=False)
class Quality:
    """How well the samples of a motion determine the parameters.

    Attributes
    ----------
    singular_values : (P,) or (p,)
        Of the stacked full (scaled) regressor, largest first; those beyond the rank are rounding.
        Of the base regressor, where its columns were scaled to unit norm.
    rank : int
        Structural rank r.
    neg_log_det : float
        −log det of the base regressor's Gram matrix (C4), SI.
    weak : tuple of WeakDirection
        The smallest first.
    deviations : (p,)
        Standard deviation of each base parameter for white torque noise of 1 N·m on every joint.
    """

    singular_values: Array
    rank: int
    neg_log_det: float
    weak: tuple[WeakDirection, ...]
    deviations: Array

    @property
    def condition_number(self) -> float:
        """σ₁/σ_r."""
        return float(self.singular_values[0] / self.singular_values[self.rank - 1])


def quality(
    model: Model,
    motion: MotionSamples,
    column_scale: Array | None,
    fit: FittedArm | None = None,
) -> Quality:
    """Evaluate the model's own columns, sharp signs included, at samples of a motion.

    Parameters
    ----------
    model : Model
    motion : MotionSamples
    column_scale : (P,) or None
        Factors of the full regressor's columns; None: base columns scaled to unit norm.
    fit : FittedArm, optional
        Shape parameters, and link parameters for effects of the load. Default: the stated ones.
    """
    base, full = stacked_regressors(model, motion, fit)
    if column_scale is None:
        norms = np.linalg.norm(base, axis=0)
        sizes, metric = np.linalg.svd(base / norms, compute_uv=False), np.diag(1.0 / norms)
    else:
        sizes = np.linalg.svd(full * column_scale, compute_uv=False)
        scaled = model.base.combination * column_scale
        metric = np.linalg.cholesky(scaled @ scaled.T)
    _, small, rows = np.linalg.svd(base @ metric, full_matrices=False)
    directions = metric @ rows.T
    names, rank = [model.base.names[k] for k in model.base.kept], model.base.count
    weak = tuple(
        _direction(float(small[-1 - k]), directions[:, -1 - k], names)
        for k in range(min(WEAK, rank))
    )
    variances = np.diag(metric @ (rows.T / small**2) @ rows @ metric.T)
    volume = float(np.linalg.slogdet(base.T @ base)[1])
    return Quality(np.asarray(sizes), rank, -volume, weak, np.sqrt(variances))


def stacked_regressors(
    model: Model, motion: MotionSamples, fit: FittedArm | None = None
) -> tuple[Array, Array]:
    """Return the base (N·n, p) and the full (N·n, P) regressor of a motion's samples.

    Parameters
    ----------
    model : Model
    motion : MotionSamples
    fit : FittedArm, optional
        As in `quality`.
    """
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


def _direction(size: float, direction: Array, names: list[str]) -> WeakDirection:
    shares = direction / np.linalg.norm(direction)
    largest = np.argsort(-np.abs(shares))[:NAMED]
    if shares[largest[0]] < 0.0:
        shares = -shares
    parts = [(names[k], float(shares[k])) for k in largest if abs(shares[k]) > NAMED_SHARE]
    return WeakDirection(size, tuple(parts))
