"""What else could explain the data as well as the winner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidate_columns import Bank
from lieid_casadi.diagnosis.screening.screen import ABSORBED, Baseline, screen
from lieid_casadi.diagnosis.search.forward_selection import column_stack, with_groups

Array = NDArray[np.float64]
SHORTLIST = 12
LEAST_GAIN = 0.5  # of the winner's: with less an effect is no rival
OWN_GAIN = 0.3  # of a rival's gain that may remain beside the winner: more, and it is another cause
DEVIATIONS = 2.0  # of the difference between two fits that the data may hide
FOLDS = 5


@dataclass(frozen=True)
class Rival:
    """A group that this data cannot separate from the winner; ``kind`` is exact or data."""

    group: int
    kind: str
    gain: float


def rivals_of(
    bank: Bank[Any],
    baseline: Baseline,
    others: Sequence[int],
    winner: int,
    blocks: NDArray[np.intp],
) -> list[Rival]:
    """Return rivals of a winner beside the other chosen groups, nearest first.

    Two fits are told apart if the difference of their squared residuals, summed over blocks of
    time, is more than two of its own standard deviations (Vuong, Econometrica 1989): right also
    where neither model is the true one.

    Parameters
    ----------
    blocks : (R,) int
        Block of time of each row.
    """
    beside = with_groups(baseline, bank, others)
    alone, both = screen(bank, beside), screen(bank, with_groups(beside, bank, [winner]))
    own = float(alone.gain[winner])
    with_winner = beside.with_columns(column_stack(bank, winner)).residual ** 2
    found: list[Rival] = []
    taken = {int(bank.candidate[g]) for g in (*others, winner)}
    for group in np.argsort(-alone.gain):
        group = int(group)
        candidate = int(bank.candidate[group])
        if alone.gain[group] < LEAST_GAIN * own or len(found) == SHORTLIST:
            break
        if candidate in taken:
            continue
        taken.add(candidate)
        if both.gain[group] > OWN_GAIN * alone.gain[group]:
            continue
        replaced = beside.with_columns(column_stack(bank, group))
        if float(screen_one(bank, replaced, winner)) < ABSORBED:
            found.append(Rival(group, "exact", float(alone.gain[group])))
        elif _alike(replaced.residual**2 - with_winner, blocks):
            found.append(Rival(group, "data", float(alone.gain[group])))
    return sorted(found, key=lambda r: (r.kind != "exact", -r.gain))


def screen_one(bank: Bank[Any], baseline: Baseline, group: int) -> float:
    """Return the part of a group's columns that a baseline does not span."""
    columns = column_stack(bank, group)
    norms = np.linalg.norm(columns, axis=0)
    scaled = baseline.padded(columns / np.where(norms > 0.0, norms, 1.0))
    rest = scaled - baseline.basis @ (baseline.basis.T @ scaled)
    return float(np.linalg.svd(rest, compute_uv=False)[0])


def _alike(worse: Array, blocks: NDArray[np.intp]) -> bool:
    sums = np.bincount(blocks, weights=worse[: len(blocks)])
    count = len(sums)
    if count < 2:
        return True
    return bool(sums.sum() < DEVIATIONS * np.sqrt(count) * sums.std(ddof=1))


def cross_validated_gain(columns: Array, baseline: Baseline, folds: NDArray[np.intp]) -> float:
    """Return the fall of the held-out sum of squares when columns (R, k) are added.

    Folds (R,) int; the coefficients of the columns come from the other folds.
    """
    columns = baseline.padded(columns)
    rest = columns - baseline.basis @ (baseline.basis.T @ columns)
    folds = np.pad(folds, (0, len(rest) - len(folds)), constant_values=-1)
    total = 0.0
    for fold in np.unique(folds[folds >= 0]):
        held = folds == fold
        values = np.linalg.lstsq(rest[~held], baseline.residual[~held], rcond=None)[0]
        after = baseline.residual[held] - rest[held] @ values
        total += float(np.sum(baseline.residual[held] ** 2) - np.sum(after**2))
    return total
