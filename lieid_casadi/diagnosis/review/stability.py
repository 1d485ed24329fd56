"""Stability of a selection: a block bootstrap of the screening in the final model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import Penalty
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.screen import SelectionState
from lieid_casadi.diagnosis.search.candidate_selection import schwarz_penalty
from lieid_casadi.diagnosis.search.search_problem import SearchProblem
from lieid_casadi.diagnosis.search.search_results import AcceptedEffect

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Competitor:
    """Columns outside the model's span, and how many parameters they add.

    Attributes
    ----------
    candidate : Candidate
    columns : (R, k)
        On the rows of the joints.
    least : float
        Least gain for which the columns are selected.
    """

    candidate: Candidate
    columns: Array
    least: float

    def scores(self, residual: Array, blocks: NDArray[np.intp], counts: Array, per: float) -> Array:
        """Return the penalized gain (B,) of each resampling of the blocks; −inf if too small.

        Parameters
        ----------
        residual : (R,)
        blocks : (R,) int
            Block of time of each row.
        counts : (B, blocks)
            How often each block is drawn.
        per : float
            Penalty for each parameter.
        """
        k, size = self.columns.shape[1], counts.shape[1]
        both = np.column_stack([self.columns, residual])
        products = [
            np.bincount(blocks, weights=both[:, a] * both[:, b], minlength=size)
            for a in range(k)
            for b in range(k + 1)
        ]
        drawn = (counts @ np.array(products).T).reshape(len(counts), k, k + 1)
        inverse = np.linalg.pinv(drawn[:, :, :k], rcond=1e-8, hermitian=True)
        gain = np.einsum("ba,bac,bc->b", drawn[:, :, k], inverse, drawn[:, :, k])
        return np.where(gain >= self.least, gain - per * self.candidate.parameters, -np.inf)


def with_stability(effect: AcceptedEffect, problem: SearchProblem) -> AcceptedEffect:
    """Return an accepted effect with the fraction of repetitions in which it is selected again.

    The screening of the final model without the effect is repeated on resampled blocks of time;
    the model's own columns are projected out once. Candidates that no data can separate from it
    do not count. If it is selected in too few repetitions, the candidates that were selected in
    its place are among its rivals.
    """
    options, placement = problem.options, effect.candidate.placement
    blocks = problem.context.time_blocks(problem.white, options.block_duration)
    without = problem.baseline_without(placement)
    columns = problem.columns_of(placement, problem.white)
    penalty = schwarz_penalty(without, problem.least_gain)
    own = _competitor(effect.candidate, columns, without, penalty, len(blocks))
    others = _competitors(problem, without, columns, penalty, len(blocks))
    random = np.random.default_rng([problem.seed, 67])
    size = int(blocks.max(initial=0)) + 1
    counts = random.multinomial(size, np.full(size, 1.0 / size), options.stability_draws)
    residual, per = without.residual[: len(blocks)], penalty.per_parameter
    scores = np.array(
        [c.scores(residual, blocks, counts.astype(float), per) for c in (own, *others)]
    )
    found = np.isfinite(scores.max(axis=0))
    wins = (
        np.bincount(scores.argmax(axis=0)[found], minlength=len(scores)) / options.stability_draws
    )
    rivals = effect.rivals
    if wins[0] < options.least_selected:
        known = {c.placement.label for c, _ in rivals}
        order = np.argsort(-wins[1:])
        rivals += tuple(
            (others[k].candidate, "data")
            for k in order
            if wins[1 + k] > 0.0 and others[k].candidate.placement.label not in known
        )
    return replace(effect, selected=float(wins[0]), rivals=rivals)


def _competitors(
    problem: SearchProblem, without: Baseline, columns: Array, penalty: Penalty, rows: int
) -> list[Competitor]:
    """Return the best grid point of every other candidate that could win against the columns."""
    options, candidates = problem.options, problem.candidates(problem.white)
    with_columns = without.with_columns(columns)
    gain = SelectionState(candidates, without, options).given([]).gain
    further = SelectionState(candidates, with_columns, options).given([])
    alone = float(np.sum(without.residual**2) - np.sum(with_columns.residual**2))
    taken = {(a.candidate.name, a.candidate.joints) for a in problem.accepted}  # and its variants
    best: dict[int, int] = {}
    for group in map(int, np.argsort(-gain)):
        if gain[group] < options.least_rival_gain * alone or len(best) == options.most_rivals:
            break
        candidate = candidates.owner(group)
        # a candidate that explains as much in addition to the effect does not compete with it
        apart = further.gain[group] > options.most_rival_gain_in_addition * gain[group]
        if further.rank[group] and not apart and (candidate.name, candidate.joints) not in taken:
            best.setdefault(int(candidates.owner_index[group]), group)
    return [
        _competitor(candidates.owner(g), candidates.stacked(g), without, penalty, rows)
        for g in best.values()
    ]


def _competitor(
    candidate: Candidate, columns: Array, baseline: Baseline, penalty: Penalty, rows: int
) -> Competitor:
    """Return columns outside a baseline's span on the rows of the joints."""
    least = penalty.part * float(np.diff(baseline.ends)[candidate.joint])
    return Competitor(candidate, baseline.outside(baseline.padded(columns))[:rows], least)
