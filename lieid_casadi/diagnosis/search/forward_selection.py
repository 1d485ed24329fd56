"""Which candidates together explain the residual: forward selection with exchange, linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidate_columns import Bank
from lieid_casadi.diagnosis.screening.screen import Baseline, Screening, screen

Array = NDArray[np.float64]
MOST = 10  # effects that are looked for together
ROUNDS = 3  # of exchange


@dataclass(frozen=True)
class Price:
    """What an effect must bring: ``each`` per parameter, and a part of the rows of one joint."""

    each: float
    part: float

    def score(self, screening: Screening) -> Array:
        """Return gain minus price of every group (G,); −inf where it brings too little."""
        rows = np.diff(screening.baseline.ends)
        bank = screening.bank
        first = np.array([c.joint for c in bank.candidates], dtype=np.intp)
        least = self.part * rows[first[bank.candidate]]
        score = screening.gain - self.each * screening.parameters
        return np.where(screening.gain >= least, score, -np.inf)


def column_stack(bank: Bank[Any], group: int) -> Array:
    """Return a group's columns on all rows (R, k)."""
    return np.concatenate(bank.dense(group))


def with_groups(baseline: Baseline, bank: Bank[Any], groups: Sequence[int]) -> Baseline:
    """Return the baseline with groups of the bank added to the model."""
    for group in groups:
        baseline = baseline.with_columns(column_stack(bank, group))
    return baseline


def best_set(
    bank: Bank[Any], baseline: Baseline, price: Price, barred: NDArray[np.bool_] | None = None
) -> list[int]:
    """Return the groups that together bring most for their price, in the order found.

    ``barred`` marks candidates that are left out.

    Forward selection; after each addition every member is exchanged for what is better beside
    the others, until nothing changes.
    """
    chosen: list[int] = []
    for _ in range(MOST):
        best = _best(bank, with_groups(baseline, bank, chosen), chosen, price, barred)
        if best is None:
            break
        chosen = _exchanged(bank, baseline, [*chosen, best], price, barred)
    return chosen


def _best(
    bank: Bank[Any],
    baseline: Baseline,
    chosen: Sequence[int],
    price: Price,
    barred: NDArray[np.bool_] | None,
) -> int | None:
    score = price.score(screen(bank, baseline))
    taken = np.isin(bank.candidate, bank.candidate[list(chosen)])
    if barred is not None:
        taken |= barred[bank.candidate]
    score = np.where(taken, -np.inf, score)
    if not len(score):
        return None
    best = int(np.argmax(score))
    return best if score[best] > 0.0 else None


def _exchanged(
    bank: Bank[Any],
    baseline: Baseline,
    chosen: list[int],
    price: Price,
    barred: NDArray[np.bool_] | None,
) -> list[int]:
    if len(chosen) < 2:
        return chosen
    for _ in range(ROUNDS):
        before = list(chosen)
        for position in range(len(chosen)):
            others = chosen[:position] + chosen[position + 1 :]
            best = _best(bank, with_groups(baseline, bank, others), others, price, barred)
            if best is not None:
                chosen[position] = best
        if chosen == before:
            break
    return chosen
