"""The torque of each effect of a fitted model along a segment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.effects import Placement
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.identification.temperature import relative_temperature
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class EffectTorque:
    """Torque (K, n) of one placed effect on every joint at the instants of a segment, N·m."""

    placement: Placement
    torque: Array


def effect_torques(fit: Fit, segment: Processed) -> tuple[EffectTorque, ...]:
    """Return the torque of every placed effect: its columns times its coefficients.

    Their sum and the rigid torque are the model's torque, not filtered.

    Parameters
    ----------
    fit : Fit
    segment : Processed
        As `process` returns it.
    """
    segment = relative_temperature(segment, fit.temperature_mean)
    columns = effects_along(fit.compiled, segment, fit.shapes, fit.parameters)
    torques = columns * fit.effect_coefficients
    found, first = [], 0
    for placement in fit.model.placements:
        last = first + len(placement.effect.coefficients)
        found.append(EffectTorque(placement, torques[:, :, first:last].sum(axis=2)))
        first = last
    return tuple(found)
