"""The torque of a change since a fit, in addition to the fit's own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.effect_columns import EffectFunction, SegmentSignals
from lieid_casadi.diagnosis.screening.incremental_effect import incremental
from lieid_casadi.effects import ArmEffect, Placement
from lieid_casadi.effects.placement import place
from lieid_casadi.identification import Fit
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]


def change_torque(
    fit: Fit, segment: Processed, label: str, parameters: Mapping[str, float]
) -> Array:
    """Return the torque (K, n) that a change adds on a segment's grid, not filtered, N·m.

    Parameters
    ----------
    fit : Fit
        That is kept.
    segment : Processed
        Of K instants, with temperatures relative to the fit's mean.
    label : str
        Of a step of a diagnosis in mode ``changed``: ``load_friction:2``.
    parameters : mapping
        Of this step: name of each coefficient and shape parameter to its value.
    """
    n = fit.model.n
    (placement,) = place(label, n)
    effect = incremental(placement.effect, [p.effect.name for p in fit.model.placements])
    signals = SegmentSignals.of(fit, segment)
    values = np.array([parameters[c.name] for c in effect.coefficients])
    if isinstance(effect, ArmEffect):
        torque = effect.segment_columns(signals.arm, placement.joint, values) @ values
        return np.asarray(torque if effect.reach != "joint" else _only(torque, placement))
    shapes = np.array([[parameters[s.name] for s in effect.shapes]])
    places = [(placement.joint, placement.source)]
    columns = EffectFunction(effect).columns(signals, places, shapes)
    torque = np.zeros((len(columns), n))
    torque[:, placement.joint] = columns[:, 0, 0] @ values
    return torque


def _only(torque: Array, placement: Placement) -> Array:
    """Return the torque of the placement's joint, zero elsewhere."""
    return np.where(np.arange(torque.shape[1]) == placement.joint, torque, 0.0)
