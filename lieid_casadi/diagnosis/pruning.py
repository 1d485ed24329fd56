"""Steps that a later one made superfluous, and steps that only stood in for something else."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.scene import Scene
from lieid_casadi.diagnosis.screening import Baseline
from lieid_casadi.diagnosis.unexplained import Unexplained
from lieid_casadi.effects import Placement
from lieid_casadi.identification.noise_model import Noise

Array = NDArray[np.float64]
# Right effects on a UR10e reach 0.06, stand-ins begin at 0.05: most, not all, are told apart.
STOOD_IN = "explains but a part of what the error follows"
STAND_IN = 0.1  # unexplained variance over what a joint's steps explain: more, and they stand in


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


def stand_ins(
    first: Baseline, last: Baseline, left: Sequence[Unexplained], placements: Sequence[Placement]
) -> list[Placement]:
    """Return effects on joints where much stays explainable beside what the effects explain.

    The right effect leaves nothing to explain; one that merely resembles it does. Naming the
    latter would send the user after the wrong cause.
    """
    out = []
    for u in left:
        rows = first.joint(u.joint)
        total, rest = (float(np.sum(b.residual[rows] ** 2)) for b in (first, last))
        if u.fraction * rest > STAND_IN * max(total - rest, 0.0):
            out += [p for p in placements if p.joint == u.joint and not p.whole_arm]
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
