"""The torque of the drives from a measured torque and identified effects on the measurement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lieid_casadi.effects import ArmEffect
from lieid_casadi.effects.joint_elasticity import JointElasticity
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.recording import Processed


def with_torque_of_drives(fit: Fit, segment: Processed) -> Processed:
    """Return a segment whose torque is that of the drives: without gains, filters, delays.

    A fit states the measured torque as that of the drives plus what effects on the measurement add
    (τ_measured = (1 + g)·τ, say). The addition along the measured motion is subtracted.

    ``segment``: with torque, and with temperatures relative to those of the training recordings.
    """
    own = np.concatenate(
        [
            np.full(len(p.effect.coefficients), _is_of_sensors(p.effect), dtype=bool)
            for p in fit.model.placements
        ]
        or [np.zeros(0, dtype=bool)]
    )
    if not own.any():
        return segment
    assert segment.tau is not None  # checked with the input
    columns = effects_along(fit.compiled, segment, fit.shapes, fit.parameters, fitted=False)
    return replace(segment, tau=segment.tau - columns[:, :, own] @ fit.effect_coefficients[own])


def _is_of_sensors(effect: object) -> bool:
    """Return whether an effect changes what sensors read, apart from links beside their motors."""
    return (
        isinstance(effect, ArmEffect)
        and effect.on_measurement
        and not effect.commanded
        and not isinstance(effect, JointElasticity)
    )
