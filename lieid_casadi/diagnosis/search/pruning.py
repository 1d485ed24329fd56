"""Steps that a later one made superfluous, and steps that only stood in for something else."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import Unexplained, smooth_columns
from lieid_casadi.diagnosis.screening.context import Scene
from lieid_casadi.diagnosis.screening.screen import Baseline
from lieid_casadi.effects import Placement
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]
STOOD_IN = "explains but a part of what the error follows"
STAND_IN = 0.03  # unexplained variance over what a joint's steps explain: more is suspicious
OWN = 0.25  # of what an effect explains alone: with less beside smooth functions it stood in


def superfluous(
    scene: Scene, noise: Sequence[Noise], placements: Sequence[Placement], part: float
) -> list[Placement]:
    """Return accepted effects without which the model fits as well: weakest first.

    An effect is superfluous if leaving it out costs less than the logarithm of the number of rows
    for each of its numbers, or less than ``part`` of the rows of its joint.
    """
    full = scene.baseline(noise)
    before = float(np.sum(full.residual**2))
    found = []
    for placement in placements:
        left_out = _columns_of(scene, placement)
        smaller = _baseline_without(scene, noise, left_out)
        cost = float(np.sum(smaller.residual**2)) - before
        rows = full.ends[placement.joint + 1] - full.ends[placement.joint]
        if cost < max(len(left_out) * np.log(max(full.rows, 2)), part * float(rows)):
            found.append((cost, placement))
    return [placement for _, placement in sorted(found, key=lambda pair: pair[0])]


def unexplained_beside(u: Unexplained, first: Baseline, last: Baseline) -> bool:
    """Whether much stays explainable on a joint beside what its effects explain."""
    rows = first.joint(u.joint)
    total, rest = (float(np.sum(b.residual[rows] ** 2)) for b in (first, last))
    return u.fraction * rest > STAND_IN * max(total - rest, 0.0)


def stands_in(whole: Baseline, without: Baseline, smooth: Array) -> bool:
    """Whether smooth functions (R, k) of what the error follows take over from an effect.

    The right effect explains as much beside them; one that merely resembles something else does
    not, and naming it would send the user after the wrong cause.

    Parameters
    ----------
    whole, without : Baseline
        The model with the effect and without it.
    """
    alone = float(np.sum(without.residual**2) - np.sum(whole.residual**2))
    small, large = (b.with_columns(smooth) for b in (without, whole))
    beside = float(np.sum(small.residual**2) - np.sum(large.residual**2))
    return beside < OWN * alone


def stand_ins(
    scene: Scene,
    noise: Sequence[Noise],
    first: Baseline,
    left: Sequence[Unexplained],
    placements: Sequence[Placement],
) -> list[Placement]:
    """Return accepted effects that only stood in for something that no effect is.

    ``first`` is the baseline before any was accepted.
    """
    last = scene.baseline(noise)
    doubtful = [u for u in left if unexplained_beside(u, first, last)]
    if not doubtful:
        return []
    bank = scene.smooth.whitened(noise, scene.runs)
    out = []
    for u, placement in product(doubtful, placements):
        if placement.joint == u.joint and not placement.whole_arm:
            without = _baseline_without(scene, noise, _columns_of(scene, placement))
            if stands_in(last, without, smooth_columns(bank, u)):
                out.append(placement)
    return out


def _columns_of(scene: Scene, placement: Placement) -> list[int]:
    """Return the positions of an effect's columns and shapes among a scene's columns."""
    model = scene.fit.model
    every = (*model.base_columns, *model.shapes)
    return [
        k
        for k, parameter in enumerate(every)
        if parameter.joint == placement.joint
        and parameter.name.rpartition(".")[0] == placement.effect.label
    ]


def _baseline_without(scene: Scene, noise: Sequence[Noise], left_out: Sequence[int]) -> Baseline:
    kept = np.setdiff1d(np.arange(scene.columns[0].shape[1]), left_out)
    matrices = [
        n.whiten(m[:, kept], r) for n, m, r in zip(noise, scene.columns, scene.runs, strict=True)
    ]
    torques = [n.whiten(t, r) for n, t, r in zip(noise, scene.torque, scene.runs, strict=True)]
    return Baseline.of(matrices, torques)
