"""Candidates, and pairs of them, that could explain the data as well as a selected one."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import ABSORBED, DiagnosisOptions
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.screen import Gains, SelectionState

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
    state: SelectionState,
    others: Sequence[int],
    group: int,
    *,
    excluded: Sequence[int],
    blocks: NDArray[np.intp],
    options: DiagnosisOptions,
) -> list[RivalGroup]:
    """Return the rivals of a group, given other groups, those that are closest first.

    Two fits differ significantly if the difference of their squared residuals, summed over
    blocks of time, exceeds two of its standard deviations (Vuong, Econometrica 1989). The test
    is valid where neither model is the true one.

    Parameters
    ----------
    state : SelectionState
    others : sequence of int
        The other selected groups.
    group : int
    excluded : sequence of int
        Groups whose candidates are no rivals: the other selected ones.
    blocks : (R,) int
        Block of time of each row.
    options : DiagnosisOptions
    """
    owners = state.candidates.owner_index
    return rivals_of_columns(
        state.given(others), state.given([*others, group]),
        state.with_groups(others), state.candidates.stacked(group),
        excluded={int(owners[g]) for g in (*excluded, group)}, blocks=blocks, options=options,
    )  # fmt: skip


def rivals_of_columns(
    alone: Gains,
    both: Gains,
    with_others: Baseline,
    columns: Array,
    *,
    excluded: Collection[int],
    blocks: NDArray[np.intp],
    options: DiagnosisOptions,
    same_form: Collection[int] = (),
) -> list[RivalGroup]:
    """Return the rivals of columns, given a baseline, those that are closest first.

    Parameters
    ----------
    alone, both : Gains
        Of all candidates without the columns, and in addition to them.
    with_others : Baseline
        Without the columns.
    columns : (R, k)
    excluded : collection of int
        Candidates that are no rivals.
    blocks : (R,) int
        Block of time of each row.
    options : DiagnosisOptions
    same_form : collection of int
        Candidates of the same family of effects. They are rivals too if they explain nearly as
        much: the true torque may have neither form.
    """
    candidates, with_columns = alone.candidates, with_others.with_columns(columns)
    own = with_others.fall(with_columns)
    found: list[RivalGroup] = []
    taken = set(excluded)
    for rival in map(int, np.argsort(-alone.gain)):
        gain = float(alone.gain[rival])
        if gain < options.least_rival_gain * own or len(found) == options.most_rivals:
            break
        owner = int(candidates.owner_index[rival])
        if owner in taken:
            continue
        taken.add(owner)
        if owner in same_form and gain >= options.least_gain_of_same_form * own:
            found.append(RivalGroup(rival, "data", gain))
            continue
        if both.gain[rival] > options.most_rival_gain_in_addition * gain:
            continue
        replaced = with_others.with_columns(candidates.stacked(rival))
        if remaining_part(columns, replaced) < ABSORBED:
            found.append(RivalGroup(rival, "exact", gain))
        elif _alike(
            replaced.residual**2 - with_columns.residual**2, blocks, options.rival_deviations
        ):
            found.append(RivalGroup(rival, "data", gain))
    return sorted(found, key=lambda r: (r.kind != "exact", -r.gain))


@dataclass(frozen=True)
class RivalPair:
    """Two groups of columns that together explain as much as the selected one.

    Attributes
    ----------
    groups : tuple of two int
    gain : float
        Fall of the sum of squares without the selected group.
    """

    groups: tuple[int, int]
    gain: float


def rival_pairs(
    candidates: CandidateColumns[Any],
    with_others: Baseline,
    columns: Array,
    *,
    parameters: int,
    tried: Sequence[int],
    blocks: NDArray[np.intp],
    options: DiagnosisOptions,
) -> list[RivalPair]:
    """Return the pairs of groups that together are rivals of columns, the largest gain first.

    Each member must add to the other a part of what the columns explain, and the pair must pay
    for its further parameters by Schwarz's penalty (Ann. Statist. 1978).

    Parameters
    ----------
    candidates : CandidateColumns
        Whitened as the baseline is.
    with_others : Baseline
        Without the columns.
    columns : (R, k)
    parameters : int
        That the columns stand for.
    tried : sequence of int
        Groups of which pairs are formed.
    blocks : (R,) int
        Block of time of each row.
    options : DiagnosisOptions
    """
    with_columns = with_others.with_columns(columns)
    total = float(np.sum(with_others.residual**2))
    own = total - float(np.sum(with_columns.residual**2))
    parts = {g: with_others.part(candidates.stacked(g)) for g in tried}
    gains = _PairGains.of(parts, with_others.residual)
    alone = {g: gains.of_groups(g) for g in tried}
    found = []
    for a, b in combinations(tried, 2):
        gain = gains.of_groups(a, b)
        further = sum(candidates.owner(g).parameters for g in (a, b)) - parameters
        pays = gain - own > float(np.log(len(blocks))) * further
        adds = gain - max(alone[a], alone[b]) > options.least_part_of_pair * own
        if not (pays and adds):
            continue
        pair = with_others.with_part(parts[a]).with_part(parts[b])
        worse = pair.residual**2 - with_columns.residual**2
        if _alike(worse, blocks, options.rival_deviations):
            found.append(RivalPair((a, b), gain))
    return sorted(found, key=lambda r: -r.gain)[: options.most_rival_pairs]


@dataclass(frozen=True, eq=False)
class _PairGains:
    """Inner products of several parts outside a span, from which the gains of pairs follow.

    Attributes
    ----------
    columns : dict
        Positions of each group's columns among all.
    gram : (m, m)
    products : (m,)
        With the residual.
    """

    columns: dict[int, NDArray[np.intp]]
    gram: Array
    products: Array

    @classmethod
    def of(cls, parts: Mapping[int, Array], residual: Array) -> _PairGains:
        """Return the inner products of parts (R, k) of groups, and of a residual (R,)."""
        ends = np.cumsum([part.shape[1] for part in parts.values()])
        every = np.hstack([np.zeros((len(residual), 0)), *parts.values()])
        places = np.split(np.arange(every.shape[1]), ends)
        columns = dict(zip(parts, places, strict=False))
        return cls(columns, every.T @ every, every.T @ residual)

    def of_groups(self, *groups: int) -> float:
        """Return the fall of the sum of squares with groups."""
        at = np.concatenate([self.columns[g] for g in groups])
        gram, products = self.gram[np.ix_(at, at)], self.products[at]
        return float(products @ np.linalg.pinv(gram, rcond=ABSORBED**2, hermitian=True) @ products)


def remaining_part(columns: Array, baseline: Baseline) -> float:
    """Return the part (0 to 1) of columns (R, k) that a baseline does not span."""
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
