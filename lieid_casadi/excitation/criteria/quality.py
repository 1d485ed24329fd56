"""How good a motion is: singular values of the full regressor, and what stays weak."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.model import Model

Array = NDArray[np.float64]
NAMED = 3  # base parameters that a weak direction is named by
WEAK = 3  # directions that are told


@dataclass(frozen=True)
class WeakDirection:
    """A direction of the parameters that torques show least.

    ``singular_value`` is the torque's root sum of squares per unit of parameter along it;
    ``parameters`` are its largest parts among the base parameters (name, share in [−1, 1]).
    """

    singular_value: float
    parameters: tuple[tuple[str, float], ...]

    @property
    def text(self) -> str:
        """E.g. ``0.9 Ixx7 − 0.4 Iyy7``."""
        first, *rest = self.parameters
        words = [f"{first[1]:.2g} {first[0]}"]
        words += [f"{'−' if share < 0 else '+'} {abs(share):.2g} {name}" for name, share in rest]
        return " ".join(words)


@dataclass(frozen=True, eq=False)
class Quality:
    """What a motion's samples tell of the parameters.

    Attributes
    ----------
    singular_values : (P,)
        Of the stacked full (scaled) regressor, largest first; beyond the rank they are rounding.
    rank : int
        Structural rank r.
    neg_log_det : float
        −log det of the base regressor's Gram matrix (C4), SI.
    weak : tuple of WeakDirection
        The smallest first.
    deviations : (p,)
        Standard deviation of each base parameter per N·m of white torque noise on every joint.
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


def quality(model: Model, motion: MotionSamples, column_scale: Array | None = None) -> Quality:
    """Judge samples of a motion by the model's own columns, sharp signs included.

    Parameters
    ----------
    column_scale : (P,), optional
        Factors of the full regressor's columns.
    """
    base, full = stacked_regressors(model, motion)
    scale = np.ones(full.shape[1]) if column_scale is None else column_scale
    sizes = np.linalg.svd(full * scale, compute_uv=False)
    gram = base.T @ base
    rank = model.base.count
    scaled = model.base.combination * scale
    metric = np.linalg.cholesky(scaled @ scaled.T)
    _, small, rows = np.linalg.svd(base @ metric, full_matrices=False)
    directions = metric @ rows.T
    names = [model.base.names[k] for k in model.base.kept]
    weak = tuple(
        _direction(float(small[-1 - k]), directions[:, -1 - k], names)
        for k in range(min(WEAK, rank))
    )
    variances = np.diag(metric @ (rows.T / small**2) @ rows @ metric.T)
    return Quality(
        np.asarray(sizes), rank, -float(np.linalg.slogdet(gram)[1]), weak, np.sqrt(variances)
    )


def stacked_regressors(model: Model, motion: MotionSamples) -> tuple[Array, Array]:
    """Return the base (N n, p) and the full (N n, P) regressor of samples."""
    from lieid_casadi.compiled import compile

    arm = compile(model)
    signals = motion.q, motion.dq, motion.ddq
    load = None
    if any("load" in p.effect.signals for p in model.placements):
        load = arm.inverse_dynamics(*signals, model.robot.link_parameters)
    columns = [arm.regressor(*signals)]
    if model.columns:
        columns.append(arm.effect_columns(*signals, load=load, time=motion.t))
    full = np.concatenate(columns, axis=2).reshape(-1, len(model.base.names))
    return np.ascontiguousarray(full[:, model.base.kept]), full


def _direction(size: float, direction: Array, names: list[str]) -> WeakDirection:
    shares = direction / np.linalg.norm(direction)
    largest = np.argsort(-np.abs(shares))[:NAMED]
    if shares[largest[0]] < 0.0:
        shares = -shares
    parts = [(names[k], float(shares[k])) for k in largest if abs(shares[k]) > 0.1]
    return WeakDirection(size, tuple(parts))
