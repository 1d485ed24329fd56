"""Quality of a motion: singular values of the regressor, and the weakest directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.excitation.fitted_arm import FittedArm, load_parameters, shapes_of
from lieid_casadi.model import Model

Array = NDArray[np.float64]
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
