"""Dry friction that changes its sign later than the measured velocity.

A joint sticks for a moment at a reversal, until the drive's torque has changed by twice the level
of dry friction. That delay, of a sample or less, cannot be seen in the positions; it resembles a
delay of the torque signal, except away from reversals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.identification.uncertainty.noise_model import Noise, dry_level, expected_sign
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]


def p_beside_late_friction(
    baseline: Baseline,
    columns: Array,
    context: ScreeningContext,
    noise: Sequence[Noise],
    placement: Placement,
    rows: Sequence[NDArray[np.bool_]] | None = None,
) -> float:
    """Return the p-value of an effect in addition to late dry friction, 0 if it delays no torque.

    Two explanations are compared, so that it is not multiplied by the number of candidates.

    Parameters
    ----------
    baseline : Baseline
        Without the effect.
    columns : (R, k)
        Of the effect, whitened as the baseline is.
    context : ScreeningContext
    noise : sequence of Noise
        By which they are whitened.
    placement : Placement
        Of the effect.
    rows : sequence of (R,) bool, optional
        Friction is late by another time on each of these sets of rows; by default by one time.
    """
    if not placement.effect.delays_torque:
        return 0.0
    n = len(context.runs)
    joints = range(n) if placement.effect.whole_arm else [placement.joint]
    late = np.concatenate(context.whitened(noise, late_friction(context, joints)))
    if rows is not None:
        late = np.hstack([late * own[:, None] for own in rows])
    return p_of_columns(baseline.with_columns(late), columns, n)


def p_of_columns(baseline: Baseline, columns: Array, n: int) -> float:
    """Return the p-value of columns in addition to a baseline.

    Parameters
    ----------
    baseline : Baseline
    columns : (R, k)
        Whitened as the baseline is.
    n : int
        Number of joints.
    """
    statistic, degrees, _ = baseline.evidence(columns, n)
    return float(chi2.sf(statistic, degrees))


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
