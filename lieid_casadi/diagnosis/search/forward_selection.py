"""Which candidates together explain the residual: forward selection with exchange."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions, Penalty
from lieid_casadi.diagnosis.screening.baseline import Baseline, with_groups
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.screen import Screening, screen

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def penalized_gain(screening: Screening, penalty: Penalty) -> Array:
    """Return gain minus penalty of every group (G,); −inf where the gain is too small."""
    rows = np.diff(screening.baseline.ends)
    candidates = screening.candidates
    first = np.array([c.joint for c in candidates.owners], dtype=np.intp)
    least = penalty.part * rows[first[candidates.owner_index]]
    score = screening.gain - penalty.per_parameter * screening.parameters
    return np.where(screening.gain >= least, score, -np.inf)


def best_set(
    candidates: CandidateColumns[Any],
    baseline: Baseline,
    penalty: Penalty,
    options: DiagnosisOptions,
    excluded: Mask | None = None,
) -> list[int]:
    """Return the groups that together have the largest penalized gain, in the order selected.

    After each addition every member is exchanged for the best group given the others, until
    nothing changes.

    Parameters
    ----------
    candidates : CandidateColumns
        Whitened as the baseline is.
    baseline : Baseline
    penalty : Penalty
    options : DiagnosisOptions
    excluded : bool array, optional
        Marks candidates (not groups) that are left out.
    """
    selection = _Selection(candidates, baseline, penalty, options, excluded)
    selected: list[int] = []
    for _ in range(options.most_effects_at_once):
        with_others = with_groups(baseline, candidates, selected)
        best = selection.best(with_others, selected)
        if best is None:
            break
        selected = [*selected, best]
        if len(selected) > 1:
            selected = selection.exchanged(selected)
    return selected


@dataclass(frozen=True, eq=False)
class _Selection:
    """The problem of `best_set`, and the best groups found, given others."""

    candidates: CandidateColumns[Any]
    baseline: Baseline
    penalty: Penalty
    options: DiagnosisOptions
    excluded: Mask | None
    found: dict[tuple[int, ...], int | None] = field(default_factory=dict)

    def best(self, with_others: Baseline, others: Sequence[int]) -> int | None:
        """Return the group with the largest positive penalized gain of a candidate not selected.

        Parameters
        ----------
        with_others : Baseline
            With the other groups.
        others : sequence of int
        """
        candidates = self.candidates
        score = penalized_gain(screen(candidates, with_others, self.options), self.penalty)
        taken = np.isin(candidates.owner_index, candidates.owner_index[list(others)])
        if self.excluded is not None:
            taken |= self.excluded[candidates.owner_index]
        score = np.where(taken, -np.inf, score)
        if not len(score):
            return None
        best = int(np.argmax(score))
        return best if score[best] > 0.0 else None

    def exchanged(self, selected: list[int]) -> list[int]:
        """Return the groups after each was replaced by the best one given the others."""
        for _ in range(self.options.exchange_rounds):
            before, first = list(selected), self.baseline
            for position in range(len(selected)):
                others = selected[:position] + selected[position + 1 :]
                key = tuple(others)
                if key not in self.found:
                    with_others = with_groups(first, self.candidates, selected[position + 1 :])
                    self.found[key] = self.best(with_others, others)
                best = self.found[key]
                selected[position] = selected[position] if best is None else best
                first = with_groups(first, self.candidates, selected[position : position + 1])
            if selected == before:
                break
        return selected
