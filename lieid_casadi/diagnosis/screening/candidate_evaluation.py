"""Evaluation of the columns of candidate effects on the rows of each joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns, assemble_columns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.effect_columns import (
    EffectFunction,
    SegmentSignals,
    columns_along,
)
from lieid_casadi.effects import ArmEffect
from lieid_casadi.identification.uncertainty.noise_model import Runs

Array = NDArray[np.float64]
#: Columns by `Candidate.key`, then by joint.
ColumnCache = dict[str, dict[int, Array]]


def evaluate_candidates(
    wanted: Sequence[Candidate],
    signals: Sequence[SegmentSignals],
    runs: Sequence[Runs],
    cache: ColumnCache | None = None,
) -> CandidateColumns[Candidate]:
    """Evaluate and filter the columns of all candidates, on the runs of each joint.

    Parameters
    ----------
    wanted : sequence of Candidate
    signals : sequence of SegmentSignals
        One per segment.
    runs : sequence of Runs
        One per joint.
    cache : dict, optional
        Columns that do not depend on the fit; pass it again with the same runs.

    Returns
    -------
    CandidateColumns
        Not whitened.
    """
    cache = {} if cache is None else cache
    owner: list[int] = []
    point: list[int] = []
    size: list[int] = []
    on_joint: list[list[tuple[int, Array]]] = [[] for _ in runs]
    first = 0
    for members in _by_effect(wanted):
        effect, grid = wanted[members[0]].effect, wanted[members[0]].grid
        fresh = [wanted[k] for k in members if wanted[k].key not in cache]
        along_arm = isinstance(effect, ArmEffect)
        evaluate = _arm_effect_columns if along_arm else _joint_effect_columns
        values = evaluate(fresh, signals, runs)
        for k in members:
            columns = cache[wanted[k].key] if wanted[k].key in cache else values[wanted[k].key]
            if "load" not in effect.signals and not along_arm:
                cache[wanted[k].key] = columns
            for joint, matrix in columns.items():
                on_joint[joint].append((first, matrix))
            total = next(iter(columns.values())).shape[1]
            owner += [k] * len(grid)
            point += range(len(grid))
            size += [total // len(grid)] * len(grid)
            first += total
    return assemble_columns(wanted, owner, point, size, on_joint, runs)


def _joint_effect_columns(
    group: Sequence[Candidate], signals: Sequence[SegmentSignals], runs: Sequence[Runs]
) -> ColumnCache:
    """Return the columns (N_j, G·c) of the candidates of one effect, by key and joint."""
    if not group:
        return {}
    function, places = EffectFunction(group[0].effect), [c.placement for c in group]
    values = np.concatenate([columns_along(function, s, places, group[0].grid) for s in signals])
    return {
        c.key: {c.joint: values[runs[c.joint].all, k].reshape(runs[c.joint].count, -1)}
        for k, c in enumerate(group)
    }


def _arm_effect_columns(
    group: Sequence[Candidate], signals: Sequence[SegmentSignals], runs: Sequence[Runs]
) -> ColumnCache:
    """Return the columns of effects that are computed along a whole segment."""
    found: ColumnCache = {}
    for c in group:
        assert isinstance(c.effect, ArmEffect)
        parts = [
            s.segment.filter(
                np.concatenate(
                    [c.effect.segment_columns(s.arm, c.joint, x) for x in c.grid], axis=2
                )
            )
            for s in signals
        ]
        values = np.concatenate(parts)
        joints = [c.joint] if c.effect.reach == "joint" else range(values.shape[1])
        found[c.key] = {j: values[runs[j].all, j] for j in joints}
    return found


def _by_effect(wanted: Sequence[Candidate]) -> list[list[int]]:
    """Return the indices of candidates of the same effect with the same grid, together."""
    groups: dict[str, list[int]] = {}
    for k, candidate in enumerate(wanted):
        key = candidate.effect.label + candidate.grid.tobytes().hex()
        groups.setdefault(key, []).append(k)
    return list(groups.values())
