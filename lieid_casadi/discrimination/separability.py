"""How well a motion separates two rival effects: noncentrality of the likelihood ratio."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from lieid_casadi.discrimination.discrimination import RivalPair
from lieid_casadi.discrimination.rival_effects import RivalEffects
from lieid_casadi.discrimination.stacked_columns import StackedColumns
from lieid_casadi.errors import NoSolution

ALIAS = 1e-6  # part of an effect below which no data can identify it; the diagnosis uses the same


def noncentrality_needed(parameters: int, level: float) -> float:
    """Return the noncentrality at which χ² rejects at 1 − level with probability level.

    Parameters
    ----------
    parameters : int
        Degrees of freedom.
    level : float
        0.5 to 1.
    """
    threshold = chi2.ppf(level, parameters)
    return float(brentq(lambda x: ncx2.sf(threshold, parameters, x) - level, 1e-6, 1e3))


def noncentrality(rivals: RivalEffects, stacked: StackedColumns, true: int, rival: int) -> float:
    """Return the noncentrality of one period if one effect is true and the other is fitted.

    Parameters
    ----------
    rivals : RivalEffects
    stacked : StackedColumns
        Along the period.
    true, rival : int
        Indices of the effects.
    """
    left = stacked.unexplained(true, rival, rivals.effects[true].coefficients)
    return float(left @ left)


def separable_pairs(rivals: RivalEffects, tried: Sequence[StackedColumns]) -> list[tuple[int, int]]:
    """Return the pairs (true, rival) that some of the motions tried can separate.

    Parameters
    ----------
    rivals : RivalEffects
    tried : sequence of StackedColumns
        Along several motions.

    Raises
    ------
    NoSolution
        An effect that the model absorbs, or two that are the same, along any motion.
    """
    for k, effect in enumerate(rivals.effects):
        if max(_part_outside_model(stacked, k, rivals) for stacked in tried) < ALIAS:
            raise NoSolution(
                f"{effect.label}: other parameters of the model absorb it along any motion, so "
                "that no data can identify it. Leave it out, or fix the parameters that absorb it"
            )
    separable = [
        pair
        for pair in rivals.pairs
        if max(_remaining(rivals, stacked, *pair) for stacked in tried) >= ALIAS
    ]
    for a, b in rivals.pairs:
        if (a, b) not in separable and (b, a) not in separable:
            one, other = rivals.effects[a].label, rivals.effects[b].label
            raise NoSolution(
                f"{one} and {other} of these sizes explain the same torque along any motion, so "
                "that no data can separate them. Leave one of them out, or state other sizes"
            )
    return separable


def rival_pairs(
    rivals: RivalEffects,
    stacked: StackedColumns,
    separable: Collection[tuple[int, int]],
    *,
    level: float,
    samples: int,
) -> tuple[RivalPair, ...]:
    """Return the result for each pair along a motion.

    Parameters
    ----------
    rivals : RivalEffects
    stacked : StackedColumns
        Along the motion.
    separable : collection of (int, int)
        Pairs (true, rival) that some motion can separate.
    level : float
    samples : int
        N of the motion.
    """
    weight = rivals.torque_weight()
    found = []
    for pair in rivals.pairs:
        true, other = (rivals.effects[k] for k in pair)
        left = stacked.unexplained(*pair, true.coefficients)
        found.append(
            RivalPair(
                true=true.label,
                rival=other.label,
                noncentrality=float(left @ left),
                needed=noncentrality_needed(true.parameters, level),
                remaining=_remaining(rivals, stacked, *pair),
                separable=pair in separable,
                residual=left.reshape(samples, -1) * np.sqrt(samples) / weight,
            )
        )
    return tuple(found)


def _part_outside_model(stacked: StackedColumns, index: int, rivals: RivalEffects) -> float:
    """Return the part (0 to 1) of an effect's torque that the common model does not span."""
    own = stacked.columns[index][0] @ rivals.effects[index].coefficients
    left = stacked.outside_model(own[:, None])
    return float(np.linalg.norm(left)) / max(float(np.linalg.norm(own)), 1e-300)


def _remaining(rivals: RivalEffects, stacked: StackedColumns, true: int, rival: int) -> float:
    """Return the part (0 to 1) of an effect's torque that the rival's refit leaves."""
    own = stacked.columns[true][0] @ rivals.effects[true].coefficients
    left = np.sqrt(noncentrality(rivals, stacked, true, rival))
    return float(left / max(float(np.linalg.norm(own)), 1e-300))
