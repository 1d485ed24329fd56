"""Which candidates together explain the residual: forward selection with exchange."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions, Penalty
from lieid_casadi.diagnosis.screening.screen import Gains, SelectionState

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def penalized_gain(gains: Gains, rows: Array, penalty: Penalty) -> Array:
    """Return gain minus penalty of every group (G,); −inf where the gain is too small.

    Parameters
    ----------
    gains : Gains
    rows : (n,)
        Number of rows of each joint.
    penalty : Penalty
    """
    candidates = gains.candidates
    least = penalty.part * rows[candidates.joint]
    score = gains.gain - penalty.per_parameter * candidates.parameters
    return np.where(gains.gain >= least, score, -np.inf)


def best_set(
    state: SelectionState,
    penalty: Penalty,
    options: DiagnosisOptions,
    excluded: Mask | None = None,
) -> list[int]:
    """Return the groups that together have the largest penalized gain, in the order selected.

    After each addition every member is exchanged for the best group given the others, until
    nothing changes.

    Parameters
    ----------
    state : SelectionState
    penalty : Penalty
    options : DiagnosisOptions
    excluded : bool array, optional
        Marks candidates (not groups) that are left out.
    """
    selected: list[int] = []
    for _ in range(options.most_effects_at_once):
        best = _best(state, penalty, excluded, selected)
        if best is None:
            break
        selected = [*selected, best]
        if len(selected) > 1:
            selected = _exchanged(state, penalty, excluded, selected, options.exchange_rounds)
    return selected


def _best(
    state: SelectionState, penalty: Penalty, excluded: Mask | None, others: Sequence[int]
) -> int | None:
    """Return the group with the largest positive penalized gain of a candidate not selected."""
    candidates = state.candidates
    if not len(candidates.size):
        return None
    score = penalized_gain(state.given(others), np.diff(state.baseline.ends), penalty)
    taken = np.isin(candidates.owner_index, candidates.owner_index[list(others)])
    if excluded is not None:
        taken |= excluded[candidates.owner_index]
    score = np.where(taken, -np.inf, score)
    best = int(np.argmax(score))
    return best if score[best] > 0.0 else None


def _exchanged(
    state: SelectionState,
    penalty: Penalty,
    excluded: Mask | None,
    selected: Sequence[int],
    rounds: int,
) -> list[int]:
    """Return the groups after each was replaced by the best one given the others."""
    selected = list(selected)
    for _ in range(rounds):
        before = list(selected)
        for position in range(len(selected)):
            others = selected[:position] + selected[position + 1 :]
            best = _best(state, penalty, excluded, others)
            selected[position] = selected[position] if best is None else best
        if selected == before:
            break
    return selected
