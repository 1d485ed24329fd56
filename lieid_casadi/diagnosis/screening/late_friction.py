"""Dry friction that changes its sign later than the measured velocity.

A joint sticks for a moment at a reversal, until the drive's torque has changed by twice the level
of dry friction. That delay, of a sample or less, cannot be seen in the positions; it resembles a
delay of the torque signal, except away from reversals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.friction_uncertainty import dry_level, expected_sign
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]


def beside_late_friction(
    baseline: Baseline, context: ScreeningContext, noise: Sequence[Noise], placement: Placement
) -> Baseline:
    """Return the baseline that an effect must improve: with late dry friction if it delays torque.

    Parameters
    ----------
    baseline : Baseline
        Without the effect.
    context : ScreeningContext
    noise : sequence of Noise
        By which the baseline is whitened.
    placement : Placement
        Of the effect.
    """
    if not placement.effect.delays_torque:
        return baseline
    joints = range(len(context.runs)) if placement.effect.whole_arm else [placement.joint]
    late = context.whitened(noise, late_friction(context, joints))
    return baseline.with_columns(np.concatenate(late))


def late_friction(context: ScreeningContext, joints: Sequence[int]) -> tuple[Array, ...]:
    """Return the columns (N_j, k) of each joint: dry friction of k joints is late, N·m/s.

    Each is the change of torque divided by the delay, for a delay of one sample.

    Parameters
    ----------
    context : ScreeningContext
    joints : sequence of int
        k joints, from 0.
    """
    change = np.concatenate([_change_of_torque(context.fit, s) for s in context.segments])
    wanted = np.asarray(joints)
    return tuple(
        change[run.all][:, wanted] * (wanted == joint) for joint, run in enumerate(context.runs)
    )


def _change_of_torque(fit: Fit, segment: Processed) -> Array:
    """Return the change of filtered torque (M, n) with dry friction, by the delay, N·m/s."""
    whole = slice(0, len(segment))
    level = dry_level(fit.compiled, segment, whole, fit.shapes, fit.parameters)
    friction = np.where(segment.moving, level * expected_sign(segment, whole), 0.0)
    late = np.vstack([friction[:1], friction[:-1]])
    return segment.filter((late - friction) * segment.rate)
