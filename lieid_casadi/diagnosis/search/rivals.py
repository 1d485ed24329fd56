"""Candidates that could explain the data as well as a selected one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import ABSORBED, DiagnosisOptions
from lieid_casadi.diagnosis.screening.baseline import Baseline, with_groups
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.screen import screen

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RivalGroup:
    """A group of columns that the data cannot separate from the selected one.

    Attributes
    ----------
    group : int
    kind : str
        ``exact`` if no data can, ``data`` if these data cannot.
    gain : float
        Fall of the sum of squares without the selected group.
    """

    group: int
    kind: str
    gain: float


def find_rivals(
    candidates: CandidateColumns[Any],
    with_others: Baseline,
    group: int,
    *,
    excluded: Sequence[int],
    blocks: NDArray[np.intp],
    options: DiagnosisOptions,
) -> list[RivalGroup]:
    """Return the rivals of a group, given a baseline, those that are closest first.

    Two fits differ significantly if the difference of their squared residuals, summed over
    blocks of time, exceeds two of its standard deviations (Vuong, Econometrica 1989). The test
    is valid where neither model is the true one.

    Parameters
    ----------
    candidates : CandidateColumns
        Whitened as the baseline is.
    with_others : Baseline
        With the other selected groups.
    group : int
    excluded : sequence of int
        Groups whose candidates are no rivals: the other selected ones.
    blocks : (R,) int
        Block of time of each row.
    options : DiagnosisOptions
    """
    alone = screen(candidates, with_others, options)
    both = screen(candidates, with_groups(with_others, candidates, [group]), options)
    own = float(alone.gain[group])
    with_group = with_others.with_columns(candidates.stacked(group)).residual ** 2
    found: list[RivalGroup] = []
    taken = {int(candidates.owner_index[g]) for g in (*excluded, group)}
    for rival in map(int, np.argsort(-alone.gain)):
        gain = float(alone.gain[rival])
        if gain < options.least_rival_gain * own or len(found) == options.most_rivals:
            break
        owner = int(candidates.owner_index[rival])
        if owner in taken:
            continue
        taken.add(owner)
        if both.gain[rival] > options.most_rival_gain_in_addition * gain:
            continue
        replaced = with_others.with_columns(candidates.stacked(rival))
        if remaining_part(candidates, replaced, group) < ABSORBED:
            found.append(RivalGroup(rival, "exact", gain))
        elif _alike(replaced.residual**2 - with_group, blocks, options.rival_deviations):
            found.append(RivalGroup(rival, "data", gain))
    return sorted(found, key=lambda r: (r.kind != "exact", -r.gain))


def remaining_part(candidates: CandidateColumns[Any], baseline: Baseline, group: int) -> float:
    """Return the part (0 to 1) of a group's columns that a baseline does not span.

    Parameters
    ----------
    candidates : CandidateColumns
    baseline : Baseline
    group : int
        Index of the group of columns.
    """
    columns = candidates.stacked(group)
    norms = np.linalg.norm(columns, axis=0)
    scaled = baseline.padded(columns / np.where(norms > 0.0, norms, 1.0))
    return float(np.linalg.svd(baseline.project_out(scaled), compute_uv=False)[0])


def _alike(worse: Array, blocks: NDArray[np.intp], deviations: float) -> bool:
    """Whether differences of squared residuals (R,) are insignificant over blocks of time."""
    sums = np.bincount(blocks, weights=worse[: len(blocks)])
    count = len(sums)
    if count < 2:
        return True
    return bool(sums.sum() < deviations * np.sqrt(count) * sums.std(ddof=1))
