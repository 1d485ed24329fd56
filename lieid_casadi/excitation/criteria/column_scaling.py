"""Scales of the full regressor's columns: the unit of each parameter in a condition number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import ExcitationError
from lieid_casadi.model import Model

Array = NDArray[np.float64]
ScalingName = Literal["si", "units", "prior", "unit_norm"]
NAMES: tuple[ScalingName, ...] = get_args(ScalingName)
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
    if scaling not in NAMES:
        raise ExcitationError(f"scaling: {scaling!r}; expected {', '.join(NAMES)} or factors")
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
